"""A servo below the camera of the simulated robot: it turns the robot on the spot, which the camera sees alike.

One that tilts the camera turns the joint of the world that does so.
"""

from __future__ import annotations

from collections.abc import Callable

from stadimeter.core.clock import Clock
from stadimeter.simulation.emulated_port import SERVED_EVERY_S
from stadimeter.simulation.motion import DifferentialRobot

# Small servos turn 60° in 0.1 to 0.2 s without a load, and slow down over the last degrees.
FASTEST_RADPS = 5.0
SETTLES_S = 0.03


class EmulatedServo:
    """A servo. Without pulses friction holds it where it is.

    Args:
        body: What it turns, straight ahead as it was at the start.
        pulse_s: How long its pulses are now; 0 for none.
        angle_rad: Where a pulse, in seconds, makes it point, from straight ahead.
    """

    def __init__(
        self, body: DifferentialRobot, clock: Clock, pulse_s: Callable[[], float], angle_rad: Callable[[float], float]
    ) -> None:
        self._body = body
        self._pulse_s = pulse_s
        self._angle_rad = angle_rad
        self.close = clock.call_every(SERVED_EVERY_S, self.serve)

    def serve(self, now_s: float) -> None:  # noqa: ARG002 - the body has the same clock
        """Turn on towards where it shall point."""
        turn_radps = 0.0
        if pulse_s := self._pulse_s():
            left_rad = self._angle_rad(pulse_s) + self._body.start.heading_rad - self._body.pose.heading_rad
            turn_radps = min(max(left_rad / SETTLES_S, -FASTEST_RADPS), FASTEST_RADPS)
        side_mps = turn_radps * self._body.track_width_m / 2
        self._body.drive_wheels(-side_mps, side_mps)
