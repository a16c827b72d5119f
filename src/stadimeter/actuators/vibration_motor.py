"""A vibration motor behind a transistor on a pin with pulse-width modulation."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from pydantic import Field

from stadimeter.actuators.output_pin import FULL_PERCENT, MIN_PULSES_HZ, OutputPin, PinOptions
from stadimeter.config.plugins import DriverContext
from stadimeter.config.units import Duration, Frequency
from stadimeter.core.command import LevelCommand


class VibrationMotorOptions(PinOptions):
    """The table of a vibration motor in the configuration."""

    verb: ClassVar = "vibrates"
    circuit: ClassVar = "motor"

    frequency: Frequency = Field(default=100.0, ge=MIN_PULSES_HZ, le=10_000.0)
    """Of the pulses. lgpio makes them in software, up to 10 kHz; the higher, the less even they are. A stop waits for
    the end of a pulse: 50 ms at 20 Hz."""
    minimum_duty: float = Field(default=0.4, gt=0.0, le=1.0)
    """The motor's weakest duty. Eccentric motors do not turn below 40 to 50 percent."""
    kick: Duration = Field(default=0.08, le=1.0)
    """For how long a motor that stands still gets full power, to break loose."""
    active_high: bool = True
    """Whether a high pin means on, as with an N-channel MOSFET."""

    def build(self, context: DriverContext) -> GpiozeroVibrationMotor:
        """Return the motor."""
        return GpiozeroVibrationMotor(self, context)


class DutySteps:
    """The duties that a motor can have, and the levels that they stand for.

    The duty is a whole percent. The percents from the weakest to 100 are evenly spaced over the levels above 0, so
    the weakest has a level above 0 as well: a level of 0 always means that the motor stands still.
    """

    def __init__(self, minimum_duty: float) -> None:
        self._weakest_percent = max(1, math.ceil(round(minimum_duty * FULL_PERCENT, 6)))
        self._count = FULL_PERCENT + 1 - self._weakest_percent

    def percent(self, level: float) -> int:
        """Return the duty for a level: the nearest step, and at least the weakest for any level above 0."""
        if level <= 0.0:
            return 0
        step = max(1, math.floor(level * self._count + 0.5))
        return self._weakest_percent - 1 + step

    def level(self, percent: int) -> float:
        """Return the level, 0 to 1, that a duty stands for."""
        return 0.0 if percent == 0 else (percent + 1 - self._weakest_percent) / self._count


class GpiozeroVibrationMotor:
    """A vibration motor."""

    def __init__(self, options: VibrationMotorOptions, context: DriverContext) -> None:
        self._pin = OutputPin(context, options.pin, active_high=options.active_high, frequency_hz=options.frequency)
        self._clock = context.clock
        self._steps = DutySteps(options.minimum_duty)
        self._kick_s = options.kick
        self._kick_ends_s = -math.inf
        self._percent = 0

    def open(self) -> None:
        """Take the pin; the motor stands still."""
        self._pin.open()

    def apply(self, command: LevelCommand) -> LevelCommand:
        """Turn as strongly as commanded, after a kick from standstill; returns the level after the kick."""
        self._pin.check_open()
        now_s = self._clock.now_s()
        percent = self._steps.percent(command.level)
        if percent > 0 and self._percent == 0:
            self._kick_ends_s = now_s + self._kick_s
        self._percent = percent
        self._drive(now_s)
        return replace(command, level=self._steps.level(percent))

    def tick(self, now_s: float) -> None:
        """End the kick when its time has come."""
        self._pin.check_open()
        self._drive(now_s)

    def stop(self) -> None:
        """Stand still at once, also during a kick. Does nothing when closed."""
        self._percent = 0
        self._pin.off()

    def close(self) -> None:
        """Stand still, then let go of the pin. May be called any number of times."""
        self._percent = 0
        self._pin.close()

    def _drive(self, now_s: float) -> None:
        kicks = self._percent > 0 and now_s < self._kick_ends_s
        self._pin.write(FULL_PERCENT if kicks else self._percent)
