"""The simulated world: a floor, a ball that moves over it, a robot with a camera, and what goes wrong.

Its options are the table ``[world]`` of a configuration.
"""

from __future__ import annotations

import bisect
import math
import threading
from collections.abc import Collection, Sequence
from enum import StrEnum
from itertools import pairwise
from typing import Any

from msgspec import Struct
from pydantic import Field, field_validator, model_validator

from stadimeter.config.plugins import DriverContext, DriverOptions, OptionsTable
from stadimeter.config.units import Angle, Coordinate, Duration, Length, LengthOrZero
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.clock import Clock
from stadimeter.errors import ConfigError
from stadimeter.simulation.motion import ORIGIN, Ball, DifferentialRobot, Hand, Pose, WayPoint

# What a simulated world says of itself: the words of its story, and what goes wrong on purpose ------


class StoryLine(OptionsTable):
    """A sentence about what the ball does, from some time on."""

    at: Duration
    """When, in seconds from the start of the path."""
    say: str = Field(min_length=1)
    """The sentence. Lengths in it are in metres, such as ``3.05 m``, and are shown in the unit that was asked for."""
    nearer: Length | None = None
    """It is said only while the ball is nearer to the camera than this; else the line before it."""
    beyond: Length | None = None
    """It is said only while the ball is further from the camera than this; else the line before it."""

    def fits(self, distance_m: float) -> bool:
        """Check whether what it says is so with the ball at a distance from the camera."""
        is_near_enough = self.nearer is None or distance_m < self.nearer
        return is_near_enough and (self.beyond is None or distance_m > self.beyond)


# The ball is not where the camera looks. Like the kinds of faults, it is said while it lasts and when it is over.
OUT_OF_SIGHT = "out-of-sight"


# What is said while a fault lasts, by its kind.
DURING = {
    "hide-target": "The ball is hidden on purpose: the robot must stop.",
    "freeze-camera": "The camera is frozen on purpose: old pictures must move nothing.",
    "freeze-under-clock": "The sensor is frozen on purpose, under a clock that runs: the robot must notice, and stop.",
    "freeze-under-noise": "The sensor is frozen on purpose, with noise added: the robot must notice, and stop.",
    "block-camera": "The camera is blocked on purpose: without pictures nothing may move.",
    "block-second-camera": "The second camera is blocked on purpose: the first one measures alone.",
    "unplug-base": "The robot's cable is out on purpose: nothing reaches it, so it must stop by itself.",
    "press-bumper": "The robot has bumped into something on purpose: it must stand.",
    "silence-sensors": "The range sensors are silent on purpose: what must not come near may be near.",
    "broker-gone": "The message broker is away on purpose: messages must wait for it.",
    OUT_OF_SIGHT: "The ball is out of the camera's sight: the robot stands still until the ball comes back.",
}

# What is said when it is over.
AFTER = {
    "hide-target": "The ball is back in sight: the robot may go on.",
    "freeze-camera": "The camera sends new pictures again: the robot may go on.",
    "freeze-under-clock": "The sensor works again: the robot may go on once it is armed.",
    "freeze-under-noise": "The sensor works again: the robot may go on once it is armed.",
    "block-camera": "The camera sends pictures again: the robot may go on.",
    "block-second-camera": "The second camera sends pictures again.",
    "unplug-base": "The robot's cable is in again: it is identified, and stands still for 3 s before it goes on.",
    "press-bumper": "Nothing presses the bumper any more: the robot may go on.",
    "silence-sensors": "The range sensors answer again: the robot may go on.",
    "broker-gone": "The message broker is back: what waited is delivered.",
    OUT_OF_SIGHT: "The ball has come back to the camera: the robot may go on.",
}

# For how long that is said.
AFTER_S = 4.0

# What is said in place of the story while the ball is not on its path.
BY_HAND = "The ball is where a hand has put it: the robot goes by where it sees it."


class Narrator:
    """Says in a sentence what happens.

    Args:
        period_s: After this long the story begins again, with the path; None or 0 for never.
    """

    def __init__(self, story: Sequence[StoryLine], period_s: float | None) -> None:
        self._story = sorted(story, key=lambda line: line.at)
        self._period_s = period_s
        self._active: tuple[str, ...] = ()
        self._over: tuple[float, str] | None = None

    def words(
        self,
        faults: Collection[str],
        now_s: float,
        *,
        path_s: float = 0.0,
        distance_m: float = 0.0,
        is_by_hand: bool = False,
    ) -> str:
        """Return the words that are said at a time.

        Args:
            faults: The kinds of what is wrong at that time, `OUT_OF_SIGHT` among them.
            now_s: That time, not before that of the last call.
            path_s: How long the ball is on its path.
            distance_m: How far from the camera it is.
            is_by_hand: Whether a hand holds it elsewhere.
        """
        ended = [kind for kind in self._active if kind not in faults]
        self._active = tuple(faults)
        if ended:
            self._over = (now_s + AFTER_S, AFTER[ended[-1]])
        if self._active:
            return " ".join(DURING[kind] for kind in self._active)
        if self._over is not None and now_s < self._over[0]:
            return self._over[1]
        if is_by_hand and self._story:
            return BY_HAND
        return self._line(path_s % self._period_s if self._period_s else path_s, distance_m)

    def _line(self, at_s: float, distance_m: float) -> str:
        begun = self._story[: bisect.bisect_right(self._story, at_s, key=lambda line: line.at)]
        return next((line.say for line in reversed(begun) if line.fits(distance_m)), "")


# The world: what is where at which time, and which faults it has ------------------------------------------------------

# Under this name the drivers of a run share the world.
SHARED_NAME = "world"


class FaultKind(StrEnum):
    """The faults of the simulated world."""

    HIDE_TARGET = "hide-target"
    FREEZE_CAMERA = "freeze-camera"
    FREEZE_UNDER_CLOCK = "freeze-under-clock"
    FREEZE_UNDER_NOISE = "freeze-under-noise"
    BLOCK_CAMERA = "block-camera"
    BLOCK_SECOND_CAMERA = "block-second-camera"
    UNPLUG_BASE = "unplug-base"
    PRESS_BUMPER = "press-bumper"
    SILENCE_SENSORS = "silence-sensors"
    BROKER_GONE = "broker-gone"


class ScheduledFault(OptionsTable):
    """Something that goes wrong at some time, and comes right again."""

    at: Duration
    """When, in seconds from the start of the run."""
    duration: Duration | None = Field(default=None, alias="for")
    """For how many seconds, written ``for``; None for the rest of the run."""
    kind: FaultKind
    """What goes wrong."""


THERE_AND_BACK = tuple(
    WayPoint.model_validate({"at": at, "x": x, "y": y})
    for at, x, y in (
        ("0 s", "1.5 m", "0 m"),
        ("6 s", "4 m", "0.6 m"),
        ("12 s", "2.5 m", "-0.5 m"),
        ("18 s", "1.5 m", "0 m"),
    )
)


class WorldOptions(DriverOptions):
    """The simulated world: where the ball goes, the robot, and what goes wrong."""

    seed: int = Field(default=1, ge=0)
    """Everything random follows from it: the same seed gives the same run."""
    ball_diameter: Length = 0.2
    """The ball's diameter."""
    ball_height: LengthOrZero | None = None
    """Height of the ball's centre above the floor; None if it lies on the floor."""
    path: tuple[WayPoint, ...] = Field(default=THERE_AND_BACK, min_length=1)
    """Where the ball is when. In between it moves smoothly and never beyond its way points."""
    loop: bool = True
    """Whether the ball begins its path again at the end, or stays there."""
    robot_x: Coordinate = 0.0
    """Where the robot starts, to the east."""
    robot_y: Coordinate = 0.0
    """Where the robot starts, to the north."""
    robot_heading: Angle = 0.0
    """Where the robot faces at the start, counter-clockwise from east."""
    track_width: Length = 0.2
    """Distance between the robot's two wheels; that of the base, if it has one and this is not written."""
    ticks_per_metre: float = Field(default=4000.0, gt=0)
    """Ticks that a wheel's encoder counts on a metre; as the base has it, if this is not written."""
    camera_height: Length = 0.25
    """Height of the camera above the floor. It looks straight ahead from between the wheels, level unless a servo tilts
    it."""
    faults: tuple[ScheduledFault, ...] = ()
    """What goes wrong when."""
    story: tuple[StoryLine, ...] = ()
    """What the views say about the ball's path, and from when on; it begins again with the path."""
    comes_back: Duration | None = None
    """A ball that the camera has not seen for this long begins its path anew, before the robot where that is now; None
    for never. While something is wrong on purpose, or a hand holds the ball, the time does not count."""

    def build(self, context: DriverContext) -> World:
        """Return the run's one world."""
        return context.share(SHARED_NAME, lambda: World(self, context.clock))

    @field_validator("path")
    @classmethod
    def _check_times(cls, path: tuple[WayPoint, ...]) -> tuple[WayPoint, ...]:
        if path[0].at != 0:
            raise ValueError(f"the path begins at {path[0].at:g} s; its first way point must be at '0 s'")
        for before, after in pairwise(path):
            if after.at <= before.at:
                raise ValueError(f"the way point at {after.at:g} s follows one at {before.at:g} s; order them by time")
        return path

    @model_validator(mode="after")
    def _check_loop(self) -> WorldOptions:
        first, last = self.path[0], self.path[-1]
        if self.loop and (first.x, first.y, first.z) != (last.x, last.y, last.z):
            raise ValueError(
                f"the path begins at ({first.x:g}, {first.y:g}) m and ends at ({last.x:g}, {last.y:g}) m; "
                "end it where it begins, or set loop = false"
            )
        return self


class Faults(Struct):
    """The knobs. Tests and people turn them by hand; the schedule of the configuration turns them too."""

    target_hidden: bool = False  # no camera shows the ball
    camera_frozen: bool = False  # the camera keeps delivering the same old frame, as a stuck driver does
    frozen_under_clock: bool = False  # the sensor shows the same old view, over which a clock is drawn that runs
    frozen_under_noise: bool = False  # the sensor shows the same old view, with noise that is added anew
    camera_blocked: bool = False  # no frame comes from the camera
    second_camera_blocked: bool = False  # no frame comes from the second camera
    base_unplugged: bool = False  # the cable to the robot base is out
    bumper_pressed: bool = False  # something presses the bumper of a simulated base
    sensors_silent: bool = False  # no range sensor answers
    broker_gone: bool = False  # the message broker does not answer


# The knob of each kind, in the same order.
KNOBS = dict(zip(FaultKind, Faults.__struct_fields__, strict=True))


# A fault that a person makes ends by itself after this long; the next try to open a base again comes soon after.
BY_HAND_S = 7.0


class FaultSchedule:
    """Turns knobs at set times from ``start_s``. A knob that was set otherwise stays so until its next time comes.

    Faults of one kind may overlap.
    """

    def __init__(self, planned: Sequence[ScheduledFault], start_s: float) -> None:
        self._by_hand: dict[FaultKind, float] = {}
        self._spans = [(fault.kind, start_s + fault.at, start_s + _end_s(fault)) for fault in planned]
        self._left = sorted(
            {(time_s, kind) for kind, begin_s, end_s in self._spans for time_s in (begin_s, end_s)}, reverse=True
        )

    def turn(self, faults: Faults, now_s: float) -> None:
        """Turn every knob whose time has come since the last call."""
        while self._left and self._left[-1][0] <= now_s:
            time_s, kind = self._left.pop()
            active = any(kind is other and begin_s <= time_s < end_s for other, begin_s, end_s in self._spans)
            setattr(faults, KNOBS[kind], active)
            self._by_hand.pop(kind, None)
        for kind in [kind for kind, end_s in self._by_hand.items() if end_s <= now_s]:
            setattr(faults, KNOBS[kind], False)
            del self._by_hand[kind]

    def toggle(self, faults: Faults, kind: FaultKind, now_s: float) -> None:
        """Turn a knob by hand. A fault ends by itself after `BY_HAND_S`, or when the schedule turns that knob."""
        is_wrong = not getattr(faults, KNOBS[kind])
        setattr(faults, KNOBS[kind], is_wrong)
        self._by_hand.pop(kind, None)
        if is_wrong:
            self._by_hand[kind] = now_s + BY_HAND_S


def _end_s(fault: ScheduledFault) -> float:
    return float("inf") if fault.duration is None else fault.at + fault.duration


class World:
    """The simulated world, which knows the truth.

    World coordinates have x to the east, y to the north and z up from the floor; headings are counter-clockwise from
    east, as in ROS REP 103. The world has no thread and takes no steps: everything in it is an exact function of time,
    so a question is answered for the moment that it is about. May be used from several threads.
    """

    def __init__(self, options: WorldOptions, clock: Clock) -> None:
        start_s = clock.now_s()
        self._clock = clock
        self._lock = threading.RLock()
        self._narrator = Narrator(
            options.story, options.path[-1].at if options.loop and len(options.path) > 1 else None
        )
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
        self._hand = Hand(self.ball.position_m)
        self._comes_back_s = options.comes_back
        self._model: CameraModel | None = None
        self._seen_s = start_s
        self._start = Pose(x_m=options.robot_x, y_m=options.robot_y, heading_rad=options.robot_heading)
        self.robot = DifferentialRobot(
            track_width_m=options.track_width, ticks_per_metre=options.ticks_per_metre, start=self._start, clock=clock
        )
        # What a servo tilts the camera with, as a body that turns on the spot: its heading is the tilt, upwards.
        self.tilt_joint = DifferentialRobot(
            track_width_m=options.track_width, ticks_per_metre=options.ticks_per_metre, start=ORIGIN, clock=clock
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

    def narration(self) -> str:
        """Return in a sentence what happens now: what goes wrong, else the story of the path as far as it is seen."""
        with self._lock:
            now_s = self.now_s
            wrong: list[str] = [kind for kind in KNOBS if self.goes_wrong(kind)]
            if not wrong and self._comes_back_s is not None and not self._is_in_sight(now_s):
                wrong = [OUT_OF_SIGHT]
            return self._narrator.words(
                wrong,
                now_s,
                path_s=self.ball.path_s(now_s),
                distance_m=self.distance_m(now_s),
                is_by_hand=self._hand.holds,
            )

    def look(self, model: CameraModel, time_s: float) -> None:
        """Take in that the camera looks, through a lens; a ball that it has not seen for long comes back."""
        with self._lock:
            self._model = model
            is_excused = self._hand.holds or any(self.goes_wrong(kind) for kind in KNOBS)
            if self._comes_back_s is None or is_excused or self._is_in_sight(time_s):
                self._seen_s = time_s
            elif time_s - self._seen_s >= self._comes_back_s:
                self.ball.begin_anew(time_s, self._start, self.robot.pose_at(time_s))

    def _is_in_sight(self, time_s: float) -> bool:
        """Check whether the whole ball is where the camera looks, hidden or not."""
        if self._model is None:
            return True
        x_m, y_m, z_m = self.target_in_camera(time_s)
        if z_m <= 0:
            return False
        lens, radius_m = self._model, self.ball.diameter_m / 2
        return all(
            centre_px + focal_px * (off_axis_m - radius_m) / z_m >= 0
            and centre_px + focal_px * (off_axis_m + radius_m) / z_m < size_px
            for centre_px, focal_px, off_axis_m, size_px in (
                (lens.cx_px, lens.fx_px, x_m, lens.width_px),
                (lens.cy_px, lens.fy_px, y_m, lens.height_px),
            )
        )

    def state(self) -> dict[str, Any]:
        """Return where ball and camera are, and what goes wrong, for a view from above."""
        now_s = self.now_s
        x_m, y_m, _ = self._hand.position_m(now_s)
        pose = self.robot.pose_at(now_s)
        return {
            "targets": [{"name": "ball", "x_m": round(x_m, 3), "y_m": round(y_m, 3)}],
            "camera": {"x_m": round(pose.x_m, 3), "y_m": round(pose.y_m, 3), "heading_rad": round(pose.heading_rad, 3)},
            "faults": {kind.value: self.goes_wrong(kind) for kind in KNOBS},
        }

    def goes_wrong(self, fault: str) -> bool:
        """Check whether a fault of this `FaultKind` is there now."""
        return bool(getattr(self.faults, KNOBS[FaultKind(fault)]))

    def toggle(self, fault: str) -> None:
        """Turn the knob of a `FaultKind`. A fault ends when it is turned again, and by itself after `BY_HAND_S`."""
        with self._lock:
            self._schedule.toggle(self.faults, FaultKind(fault), self.now_s)

    def place_target(self, x_m: float, y_m: float) -> None:
        """Move the ball there, by hand, and leave it there."""
        self._hand.put((x_m, y_m), self.now_s)

    def let_go(self) -> None:
        """Let the ball go back to its path."""
        self._hand.put(None, self.now_s)

    def in_world_m(self, bearing_rad: float, distance_m: float) -> tuple[float, float]:
        """Return where a ball on the floor is that a level camera would see there now: x to the east, y to the north.

        Args:
            bearing_rad: Positive to the right.
            distance_m: From the camera to the ball's centre; no less than they differ in height.
        """
        pose = self.robot.pose_at(self.now_s)
        along_floor_m = math.sqrt(max(0.0, distance_m**2 - (self.camera_height_m - self.ball.height_m) ** 2))
        heading_rad = pose.heading_rad - bearing_rad
        return (pose.x_m + along_floor_m * math.cos(heading_rad), pose.y_m + along_floor_m * math.sin(heading_rad))

    def target_in_camera(self, time_s: float | None = None, aside_m: float = 0.0) -> tuple[float, float, float]:
        """Return where the ball's centre truly is as the camera on the robot sees it, hidden or not, now or at a time.

        The position is in metres: x to the right, y down, z forward along the optical axis. A `DriverError` says that
        the time is longer ago than the robot remembers.

        Args:
            aside_m: How far to the right of that camera another one is that sees it.
        """
        at_s = self._clock.now_s() if time_s is None else time_s
        pose = self.robot.pose_at(at_s)
        ball_x, ball_y, ball_z = self._hand.position_m(at_s)
        east, north = ball_x - pose.x_m, ball_y - pose.y_m
        cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        right_m, forward_m = east * sin - north * cos - aside_m, east * cos + north * sin
        down_m = self.camera_height_m - ball_z
        tilt_rad = self.tilt_joint.pose_at(at_s).heading_rad
        up, level = math.sin(tilt_rad), math.cos(tilt_rad)
        return (right_m, down_m * level + forward_m * up, forward_m * level - down_m * up)

    def distance_m(self, time_s: float | None = None) -> float:
        """Return the true length of the line from the camera to the ball's centre; errors as `target_in_camera`."""
        return math.hypot(*self.target_in_camera(time_s))


def shared_world(context: DriverContext) -> World:
    """Return the world that the drivers of a run share, or raise a `ConfigError` if it has none."""

    def missing() -> World:
        raise ConfigError(f"'{context.name}' is simulated and needs a world to be in; add a table [world]")

    return context.share(SHARED_NAME, missing)
