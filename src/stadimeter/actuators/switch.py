"""Things that are on or off: a lamp, which may also be dimmed, and a relay."""

from __future__ import annotations

import math
from typing import ClassVar, Self

from pydantic import Field, model_validator

from stadimeter.actuators.pin_actuator import OutputPinOptions, PinActuator
from stadimeter.config.plugins import DriverContext
from stadimeter.config.units import Frequency
from stadimeter.gpio.output_pin import FULL_PERCENT, MIN_PULSES_HZ, OutputPin


class LedOptions(OutputPinOptions):
    """The table of a lamp in the configuration."""

    verb: ClassVar = "lights"
    circuit: ClassVar = "led"

    on_at: float = Field(default=0.5, gt=0.0, le=1.0)
    """The level from which it is on."""
    dimmed: bool = False
    """Whether it is as bright as the level says, instead of on or off."""
    frequency: Frequency = Field(default=100.0, ge=MIN_PULSES_HZ, le=10_000.0)
    """Of the pulses that dim it: below 20 Hz it would blink, and go off late."""

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
        return GpiozeroSwitch(pin, context, None if self.dimmed else self.on_at)


class RelayOptions(OutputPinOptions):
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
        return GpiozeroSwitch(OutputPin(context, self.pin, active_high=self.active_high), context, self.on_at)


class GpiozeroSwitch(PinActuator):
    """Something on a pin that is on or off, or as bright as the level says, in whole percents.

    It has no deadband of its own: rules that switch have theirs, and delays too.

    Args:
        on_at: The level from which it is on; None for one that is dimmed.
    """

    def __init__(self, pin: OutputPin, context: DriverContext, on_at: float | None) -> None:
        super().__init__(pin, context)
        self._on_at = on_at
        self._share = 0.0

    def _take_level(self, level: float, now_s: float) -> float:  # noqa: ARG002 - a switch has no pattern
        percent = math.floor(level * FULL_PERCENT + 0.5)
        self._share = percent / FULL_PERCENT if self._on_at is None else float(level >= self._on_at)
        return self._share

    def _percent(self, now_s: float) -> int:  # noqa: ARG002
        return round(self._share * FULL_PERCENT)
