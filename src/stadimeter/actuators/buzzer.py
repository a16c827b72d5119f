"""An active buzzer: one that sounds by itself when it gets power."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from stadimeter.actuators.pin_actuator import OutputPinOptions, PinActuator
from stadimeter.config.plugins import DriverContext
from stadimeter.config.units import Duration
from stadimeter.gpio.output_pin import FULL_PERCENT, OutputPin


class BeepPattern:
    """Beeps of one length whose rate follows a level, as in a parking sensor.

    The period goes from the slowest to the fastest in equal ratios: a step of level sounds like the same step
    everywhere. A change of level moves the next beep, never the one that sounds.

    Args:
        slowest_s: The period, from one beep's start to the next one's, at the lowest level above 0.
        fastest_s: The period just below level 1, at most `slowest_s`.
        beep_s: How long a beep is, less than `fastest_s`.
    """

    def __init__(self, *, slowest_s: float, fastest_s: float, beep_s: float) -> None:
        self._slowest_s = slowest_s
        self._ratio = fastest_s / slowest_s
        self._beep_s = beep_s
        self._started_s: float | None = None

    def period_s(self, level: float) -> float:
        """Return the time from one beep's start to the next one's: ``slowest_s * (fastest_s / slowest_s) ** level``."""
        return float(self._slowest_s * self._ratio**level)

    def sounds(self, level: float, now_s: float) -> bool:
        """Move on to a time and return whether it sounds then. Asking twice for one time gives the same answer.

        Args:
            level: 0 is silent, and the first level above it beeps at once; 1 sounds without a break.
        """
        if level <= 0.0:
            self._started_s = None
            return False
        self._started_s = self._newest_start_s(self.period_s(level), now_s)
        return level >= 1.0 or now_s - self._started_s < self._beep_s

    def _newest_start_s(self, period_s: float, now_s: float) -> float:
        if self._started_s is None:
            return now_s
        due_s = self._started_s + period_s
        if now_s < due_s:
            return self._started_s
        # Counted from when it was due, so that late ticks do not slow the beeping down, but never so far back that
        # the beep would be over before it was heard.
        return due_s if now_s - due_s < self._beep_s / 2 else now_s


class BuzzerOptions(OutputPinOptions):
    """The table of a buzzer in the configuration."""

    verb: ClassVar = "buzzes"
    circuit: ClassVar = "buzzer"

    slowest: Duration = Field(default=1.0, le=60.0)
    """From one beep to the next at the lowest level above 0."""
    fastest: Duration = 0.1
    """From one beep to the next just below the full level."""
    beep: Duration = Field(default=0.05, ge=0.04)  # two ticks: less might fall between them
    """How long a beep is."""
    steady: bool = False
    """Sound without a break at any level above 0."""

    @model_validator(mode="after")
    def _beeps_have_gaps(self) -> Self:
        if not self.beep + 0.04 <= self.fastest <= self.slowest:
            raise ValueError(
                f"beep ({self.beep:g} s) must be at least 40 ms shorter than fastest ({self.fastest:g} s), and fastest "
                f"no longer than slowest ({self.slowest:g} s), or the beeps run together"
            )
        return self

    def build(self, context: DriverContext) -> GpiozeroBuzzer:
        """Return the buzzer."""
        return GpiozeroBuzzer(self, context)


class GpiozeroBuzzer(PinActuator):
    """A buzzer. Level 0 is silent, a rising level beeps faster, and 1 sounds without a break.

    A beep that sounds is not begun anew. A steady buzzer only knows 0 and 1.
    """

    def __init__(self, options: BuzzerOptions, context: DriverContext) -> None:
        super().__init__(OutputPin(context, options.pin, active_high=options.active_high), context)
        self._pattern = BeepPattern(slowest_s=options.slowest, fastest_s=options.fastest, beep_s=options.beep)
        self._steady = options.steady
        self._level = 0.0

    def _take_level(self, level: float, now_s: float) -> float:
        self._level = float(level > 0.0) if self._steady else level
        self._pattern.sounds(self._level, now_s)
        return self._level

    def _percent(self, now_s: float) -> int:
        return FULL_PERCENT if self._pattern.sounds(self._level, now_s) else 0
