"""Things that are on or off: a lamp, which may also be dimmed, and a relay."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar, Self

from pydantic import Field, model_validator

from stadimeter.actuators.output_pin import FULL_PERCENT, MIN_PULSES_HZ, OutputPin, PinOptions
from stadimeter.config.plugins import DriverContext
from stadimeter.config.units import Frequency
from stadimeter.core.command import LevelCommand


class LedOptions(PinOptions):
    """The table of a lamp in the configuration."""

    verb: ClassVar = "lights"
    circuit: ClassVar = "led"

    on_at: float = Field(default=0.5, gt=0.0, le=1.0)
    """The level from which it is on."""
    dimmed: bool = False
    """Whether it is as bright as the level says, instead of on or off."""
    frequency: Frequency = Field(default=100.0, ge=MIN_PULSES_HZ, le=10_000.0)
    """Of the pulses that dim it: below 20 Hz it would blink, and go off late."""
    active_high: bool = True
    """Whether a high pin means on."""

    @model_validator(mode="after")
    def _one_way_only(self) -> Self:
        needless = {"on_at"} if self.dimmed else {"frequency"}
        for key in sorted(needless & self.model_fields_set):
            raise ValueError(f"{key} has no meaning with dimmed = {str(self.dimmed).lower()}; leave one of them out")
        return self

    def build(self, context: DriverContext) -> GpiozeroSwitch:
        """Return the lamp."""
        frequency_hz = self.frequency if self.dimmed else None
        pin = OutputPin(context, self.pin, active_high=self.active_high, frequency_hz=frequency_hz)
        return GpiozeroSwitch(pin, _nearest_percent if self.dimmed else _on_from(self.on_at))


class RelayOptions(PinOptions):
    """The table of a relay in the configuration."""

    verb: ClassVar = "switches on"
    is_worn_by_switching: ClassVar = True
    circuit: ClassVar = "relay"

    on_at: float = Field(default=0.5, gt=0.0, le=1.0)
    """The level from which it is on."""
    active_high: bool = False
    """Whether a high pin means on. Most relay boards switch on when their input is pulled low, so it is not unless you
    say so. Try it without a load first: with the wrong value the relay is on while all is quiet."""

    def build(self, context: DriverContext) -> GpiozeroSwitch:
        """Return the relay."""
        return GpiozeroSwitch(OutputPin(context, self.pin, active_high=self.active_high), _on_from(self.on_at))


class GpiozeroSwitch:
    """Something on a pin that is on or off, or as bright as the level says.

    It has no deadband of its own: rules that switch have theirs, and delays too.
    """

    def __init__(self, pin: OutputPin, percent_of: Callable[[float], int]) -> None:
        self._pin = pin
        self._percent_of = percent_of

    def open(self) -> None:
        """Take the pin, off."""
        self._pin.open()

    def apply(self, command: LevelCommand) -> LevelCommand:
        """Switch, or dim. The level returned is 0 or 1, or a whole percent if it is dimmed."""
        percent = self._percent_of(command.level)
        self._pin.write(percent)
        return replace(command, level=percent / FULL_PERCENT)

    def tick(self, now_s: float) -> None:  # noqa: ARG002 - part of the interface; a switch has no pattern
        """Do nothing: there is no pattern to move on."""
        self._pin.check_open()

    def stop(self) -> None:
        """Switch off at once. Does nothing when closed."""
        self._pin.off()

    def close(self) -> None:
        """Switch off, then let go of the pin. May be called any number of times."""
        self._pin.close()


def _nearest_percent(level: float) -> int:
    return math.floor(level * FULL_PERCENT + 0.5)


def _on_from(on_at: float) -> Callable[[float], int]:
    return lambda level: FULL_PERCENT if level >= on_at else 0
