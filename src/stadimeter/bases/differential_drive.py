"""Kinematics of a robot with a driven wheel on each side, and the whole numbers that bases count in."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Struct
from pydantic import AfterValidator

from stadimeter.config.units import Duration

# Kinematics of a robot with a driven wheel on each side. Pure functions of numbers ------------------------------------
#
# With speed v, rate of turn ω (positive to the left) and track width b, the wheels run at v ∓ ω·b/2, left and
# right. Source: the standard model of a differential drive, e.g. Siegwart and Nourbakhsh, Introduction to
# Autonomous Mobile Robots, section 3.2.


class Motion(Struct, frozen=True, kw_only=True):
    """The robot's speed forwards, and its rate of turn, positive to the left."""

    linear_mps: float
    angular_radps: float


class WheelSpeeds(Struct, frozen=True, kw_only=True):
    """The speeds at which both wheels roll, positive forwards."""

    left_mps: float
    right_mps: float


class DifferentialDrive(Struct, frozen=True, kw_only=True):
    """A robot's wheels.

    Attributes:
        track_width_m: Distance between the middles of the two wheels.
        max_wheel_mps: No wheel rolls faster.
    """

    track_width_m: float
    max_wheel_mps: float

    def wheels(self, motion: Motion) -> WheelSpeeds:
        """Return the wheel speeds for a motion.

        If a wheel would be too fast, both are slowed in the same proportion, so the robot keeps to its curve and
        drives along it more slowly.
        """
        offset_mps = motion.angular_radps * self.track_width_m / 2
        left_mps, right_mps = motion.linear_mps - offset_mps, motion.linear_mps + offset_mps
        fastest_mps = max(abs(left_mps), abs(right_mps))
        scale = self.max_wheel_mps / fastest_mps if fastest_mps > self.max_wheel_mps else 1.0
        return WheelSpeeds(left_mps=left_mps * scale, right_mps=right_mps * scale)

    def motion(self, wheels: WheelSpeeds) -> Motion:
        """Return the motion that wheel speeds make."""
        return Motion(
            linear_mps=(wheels.left_mps + wheels.right_mps) / 2,
            angular_radps=(wheels.right_mps - wheels.left_mps) / self.track_width_m,
        )


# The whole numbers that bases count: steps of speed, encoder counts that wrap around, and units of their time-out -----

# In these a RoboClaw and a Sabertooth count their serial time-out, which 0 would switch off.
TIMEOUT_UNIT_S = 0.1
# A robot at 0.5 m/s rolls 25 cm in this time.
MAX_TIMEOUT_S = 0.5


def _check_timeout(timeout_s: float) -> float:
    units = timeout_s / TIMEOUT_UNIT_S
    if not 1 <= round(units) <= round(MAX_TIMEOUT_S / TIMEOUT_UNIT_S) or abs(units - round(units)) > 1e-6:
        raise ValueError(
            f"{timeout_s * 1e3:g} ms: the board counts its time-out in {TIMEOUT_UNIT_S * 1e3:.0f} ms, and a robot "
            f"without commands shall stop within {MAX_TIMEOUT_S * 1e3:.0f} ms; write '100 ms', '200 ms' … '500 ms'"
        )
    return timeout_s


SerialTimeout = Annotated[Duration, AfterValidator(_check_timeout)]


class SpeedSteps(Struct, frozen=True, kw_only=True):
    """The speeds that a base can be given: whole multiples of one step."""

    step_mps: float

    def limit_mps(self, max_wheel_mps: float) -> float:
        """Return the highest speed that can be given and is within a limit."""
        return math.floor(max_wheel_mps / self.step_mps + 1e-9) * self.step_mps  # a limit of exactly n steps gives n

    def count(self, wheels: WheelSpeeds) -> tuple[int, int]:
        """Return the nearest numbers of steps for the left and the right wheel."""
        return round(wheels.left_mps / self.step_mps), round(wheels.right_mps / self.step_mps)

    def speeds(self, left: int, right: int) -> WheelSpeeds:
        """Return the wheel speeds that two numbers of steps stand for."""
        return WheelSpeeds(left_mps=left * self.step_mps, right_mps=right * self.step_mps)


class EncoderCounter:
    """The distance a wheel has rolled, from a counter that wraps around: less than half its range between two readings.

    Args:
        bits: The width of the counter.
        count_m: How far the wheel rolls in one count.
    """

    def __init__(self, *, bits: int, count_m: float) -> None:
        self._range = 1 << bits
        self._count_m = count_m
        self._counts: int | None = None

    def travel_m(self, reading: int) -> float:
        """Return the distance that the wheel has rolled in all, backwards negative, after a reading of the counter."""
        last = reading if self._counts is None else self._counts
        half = self._range // 2
        self._counts = last + (reading - last + half) % self._range - half
        return self._counts * self._count_m
