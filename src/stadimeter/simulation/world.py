"""The simulated world: a floor, a ball that moves over it, a robot with a camera, and what goes wrong."""

from __future__ import annotations

import math
import threading

from stadimeter.config.plugins import DriverContext, Plugin
from stadimeter.core.clock import Clock
from stadimeter.errors import ConfigError
from stadimeter.simulation.ball import Ball
from stadimeter.simulation.faults import Faults, FaultSchedule
from stadimeter.simulation.options import WorldOptions
from stadimeter.simulation.robot import DifferentialRobot, Pose

SHARED_NAME = "world"
"""Under this name the drivers of a run share the world."""


class World:
    """The simulated world, which knows the truth.

    World coordinates have x to the east, y to the north and z up from the floor; headings are counter-clockwise from
    east, as in ROS REP 103. The world has no thread and takes no steps: everything in it is an exact function of time,
    so a question is answered for the moment that it is about. May be used from several threads.

    Args:
        clock: The run's clock. The times in the options count from what it shows now.
    """

    def __init__(self, options: WorldOptions, clock: Clock) -> None:
        start_s = clock.now_s()
        self._clock = clock
        self._lock = threading.RLock()
        self._faults = Faults()
        self._schedule = FaultSchedule(options.faults, start_s)
        self.seed = options.seed
        self.camera_height_m = options.camera_height
        self.ball = Ball(
            diameter_m=options.ball_diameter,
            height_m=options.ball_diameter / 2 if options.ball_height is None else options.ball_height,
            path=options.path,
            loop=options.loop,
            start_s=start_s,
        )
        self.robot = DifferentialRobot(
            track_width_m=options.track_width,
            ticks_per_metre=options.ticks_per_metre,
            start=Pose(x_m=options.robot_x, y_m=options.robot_y, heading_rad=options.robot_heading),
            clock=clock,
        )

    @property
    def now_s(self) -> float:
        """The time on the run's clock."""
        return self._clock.now_s()

    @property
    def faults(self) -> Faults:
        """The knobs for what goes wrong, as of now. Ask again each time: the schedule turns them when asked."""
        with self._lock:
            self._schedule.turn(self._faults, self._clock.now_s())
        return self._faults

    def target_in_camera(self, time_s: float | None = None) -> tuple[float, float, float]:
        """Return where the ball's centre truly is as the camera on the robot sees it, hidden or not.

        Args:
            time_s: A time on the run's clock; None for now.

        Returns:
            The position in metres: x to the right, y down, z forward along the optical axis.

        Raises:
            DriverError: That is longer ago than the robot remembers.
        """
        at_s = self._clock.now_s() if time_s is None else time_s
        pose = self.robot.pose_at(at_s)
        ball_x, ball_y, ball_z = self.ball.position_m(at_s)
        east, north = ball_x - pose.x_m, ball_y - pose.y_m
        cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        return (east * sin - north * cos, self.camera_height_m - ball_z, east * cos + north * sin)

    def distance_m(self, time_s: float | None = None) -> float:
        """Return the true length of the straight line from the camera to the ball's centre.

        Args:
            time_s: A time on the run's clock; None for now.

        Raises:
            DriverError: That is longer ago than the robot remembers.
        """
        return math.hypot(*self.target_in_camera(time_s))


def shared_world(context: DriverContext) -> World:
    """Return the world that the drivers of a run share.

    Args:
        context: The run that a driver is part of.

    Raises:
        ConfigError: The run has none.
    """

    def missing() -> World:
        raise ConfigError(f"'{context.name}' is simulated and needs a world to be in; add a table [world]")

    return context.share(SHARED_NAME, missing)


def _build(options: WorldOptions, context: DriverContext) -> World:
    return context.share(SHARED_NAME, lambda: World(options, context.clock))


PLUGIN = Plugin(WorldOptions, _build)
