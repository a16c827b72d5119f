"""A servo below the camera of the simulated robot: it turns the robot on the spot, which the camera sees alike."""

from __future__ import annotations

from collections.abc import Callable

from stadimeter.core.clock import Clock
from stadimeter.simulation.emulated_port import SERVED_EVERY_S
from stadimeter.simulation.world import World

# Small servos turn 60° in 0.1 to 0.2 s without a load, and slow down over the last degrees.
FASTEST_RADPS = 5.0
SETTLES_S = 0.03


class EmulatedServo:
    """A servo. Without pulses friction holds it where it is.

    Args:
        pulse_s: How long its pulses are now; 0 for none.
        heading_rad: Where a pulse, in seconds, makes it point, positive to the left of straight ahead.
    """

    def __init__(
        self, world: World, clock: Clock, pulse_s: Callable[[], float], heading_rad: Callable[[float], float]
    ) -> None:
        self._robot = world.robot
        self._pulse_s = pulse_s
        self._heading_rad = heading_rad
        self._ahead_rad = world.robot.pose.heading_rad
        self.close = clock.call_every(SERVED_EVERY_S, self.serve)

    def serve(self, now_s: float) -> None:  # noqa: ARG002 - the robot has the same clock
        """Turn on towards where it shall point."""
        turn_radps = 0.0
        if pulse_s := self._pulse_s():
            left_rad = self._heading_rad(pulse_s) + self._ahead_rad - self._robot.pose.heading_rad
            turn_radps = min(max(left_rad / SETTLES_S, -FASTEST_RADPS), FASTEST_RADPS)
        side_mps = turn_radps * self._robot.track_width_m / 2
        self._robot.drive_wheels(-side_mps, side_mps)
