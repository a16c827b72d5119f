"""Things that are on or off: a lamp, which may also be dimmed, and a relay."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Self

from pydantic import Field, model_validator

from stadimeter.actuators.output_pin import FULL_PERCENT, MIN_PULSES_HZ, OutputPin, pins_lack
from stadimeter.config.plugins import DriverContext, Options, Plugin
from stadimeter.config.units import Frequency, Pin
from stadimeter.core.command import LevelCommand


class LedOptions(Options):
    """The table of a lamp in the configuration."""

    pin: Pin
    """The BCM number of the pin."""
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


class RelayOptions(Options):
    """The table of a relay in the configuration."""

    pin: Pin
    """The BCM number of the pin."""
    on_at: float = Field(default=0.5, gt=0.0, le=1.0)
    """The level from which it is on."""
    active_high: bool = False
    """Whether a high pin means on. Most relay boards switch on when their input is pulled low, so it is not unless you
    say so. Try it without a load first: with the wrong value the relay is on while all is quiet."""


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


def build_led(options: LedOptions, context: DriverContext) -> GpiozeroSwitch:
    """Make a lamp."""
    pin = OutputPin(
        context,
        options.pin,
        active_high=options.active_high,
        frequency_hz=options.frequency if options.dimmed else None,
    )
    return GpiozeroSwitch(pin, _nearest_percent if options.dimmed else _on_from(options.on_at))


def build_relay(options: RelayOptions, context: DriverContext) -> GpiozeroSwitch:
    """Make a relay."""
    return GpiozeroSwitch(OutputPin(context, options.pin, active_high=options.active_high), _on_from(options.on_at))


def _nearest_percent(level: float) -> int:
    return math.floor(level * FULL_PERCENT + 0.5)


def _on_from(on_at: float) -> Callable[[float], int]:
    return lambda level: FULL_PERCENT if level >= on_at else 0


LED_PLUGIN = Plugin(options=LedOptions, build=build_led, lacks=pins_lack, verb="lights", circuit="led")
RELAY_PLUGIN = Plugin(
    options=RelayOptions,
    build=build_relay,
    lacks=pins_lack,
    verb="switches on",
    is_worn_by_switching=True,
    circuit="relay",
)
