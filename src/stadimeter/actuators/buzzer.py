"""An active buzzer: one that sounds by itself when it gets power."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

from pydantic import Field, model_validator

from stadimeter.actuators.beep_pattern import BeepPattern
from stadimeter.actuators.output_pin import FULL_PERCENT, OutputPin
from stadimeter.config.plugins import DriverContext, Options, Plugin
from stadimeter.config.units import Duration, Pin
from stadimeter.core.command import LevelCommand


class BuzzerOptions(Options):
    """What a buzzer's table in the configuration holds.

    Attributes:
        pin: The BCM number of the pin.
        slowest: From one beep to the next at the lowest level above 0.
        fastest: From one beep to the next just below the full level.
        beep: How long a beep is.
        steady: Sound without a break at any level above 0.
        active_high: Whether a high pin means on.
    """

    pin: Pin
    slowest: Duration = Field(default=1.0, le=60.0)
    fastest: Duration = 0.1
    beep: Duration = Field(default=0.05, ge=0.04)  # two ticks: less might fall between them
    steady: bool = False
    active_high: bool = True

    @model_validator(mode="after")
    def _beeps_have_gaps(self) -> Self:
        if not self.beep + 0.04 <= self.fastest <= self.slowest:
            raise ValueError(
                f"beep ({self.beep:g} s) must be at least 40 ms shorter than fastest ({self.fastest:g} s), and fastest "
                f"no longer than slowest ({self.slowest:g} s), or the beeps run together"
            )
        return self


class GpiozeroBuzzer:
    """A buzzer. Level 0 is silent, a rising level beeps faster, and 1 sounds without a break."""

    def __init__(self, options: BuzzerOptions, context: DriverContext) -> None:
        self._pin = OutputPin(context, options.pin, active_high=options.active_high)
        self._clock = context.clock
        self._pattern = BeepPattern(slowest_s=options.slowest, fastest_s=options.fastest, beep_s=options.beep)
        self._steady = options.steady
        self._level = 0.0

    def open(self) -> None:
        """Take the pin; the buzzer is silent."""
        self._pin.open()

    def apply(self, command: LevelCommand) -> LevelCommand:
        """Beep as fast as commanded. A beep that sounds is not begun anew.

        Returns:
            The command; a steady buzzer knows the levels 0 and 1 only.
        """
        self._pin.check_open()
        self._level = float(command.level > 0.0) if self._steady else command.level
        self._drive(self._clock.now_s())
        return replace(command, level=self._level)

    def tick(self, now_s: float) -> None:
        """Begin and end beeps."""
        self._pin.check_open()
        self._drive(now_s)

    def stop(self) -> None:
        """Be silent at once, in the middle of a beep too. Does nothing when closed."""
        self._be_silent()
        self._pin.off()

    def close(self) -> None:
        """Be silent, then let go of the pin. May be called any number of times."""
        self._be_silent()
        self._pin.close()

    def _be_silent(self) -> None:
        self._level = 0.0
        self._pattern.sounds(0.0, self._clock.now_s())

    def _drive(self, now_s: float) -> None:
        self._pin.write(FULL_PERCENT if self._pattern.sounds(self._level, now_s) else 0)


PLUGIN = Plugin(options=BuzzerOptions, build=GpiozeroBuzzer)
