"""The whole numbers that bases count: steps of speed, encoder counts that wrap around, and units of their time-out."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Struct
from pydantic import AfterValidator

from stadimeter.bases.differential_drive import WheelSpeeds
from stadimeter.config.units import Duration

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
