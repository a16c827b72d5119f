"""An actuator on one pin, and its options."""

from __future__ import annotations

from abc import ABC, abstractmethod

from msgspec.structs import replace

from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import LevelCommand
from stadimeter.gpio.output_pin import OutputPin, PinOptions


class OutputPinOptions(PinOptions):
    """The options of an actuator on one pin."""

    active_high: bool = True
    """Whether a high pin means on."""


class PinActuator(ABC):
    """An actuator on one pin: how long it is on follows from the newest level and the time."""

    def __init__(self, pin: OutputPin, context: DriverContext) -> None:
        self._pin = pin
        self._clock = context.clock

    def open(self) -> None:
        """Take the pin, off."""
        self._pin.open()

    def apply(self, command: LevelCommand) -> LevelCommand:
        """Act as commanded; returns the level that the device can do."""
        self._pin.check_open()
        now_s = self._clock.now_s()
        level = self._take_level(command.level, now_s)
        self._pin.write(self._percent(now_s))
        return replace(command, level=level)

    def tick(self, now_s: float) -> None:
        """Move on what changes with the time."""
        self._pin.check_open()
        self._pin.write(self._percent(now_s))

    def stop(self) -> None:
        """Switch off at once. Does nothing when closed."""
        self._take_level(0.0, self._clock.now_s())
        self._pin.off()

    def close(self) -> None:
        """Switch off, then let go of the pin. May be called any number of times."""
        self._take_level(0.0, self._clock.now_s())
        self._pin.close()

    @abstractmethod
    def _take_level(self, level: float, now_s: float) -> float:
        """Remember a level from 0 to 1, and return the one that stands for what the device will do."""

    @abstractmethod
    def _percent(self, now_s: float) -> int:
        """Return for how many percent of the time the pin is on, now."""
