"""A vibration motor behind a transistor on a pin with pulse-width modulation."""

from __future__ import annotations

import math
from typing import ClassVar

from pydantic import Field

from stadimeter.actuators.pin_actuator import OutputPinOptions, PinActuator
from stadimeter.config.plugins import DriverContext
from stadimeter.config.units import Duration, Frequency
from stadimeter.gpio.output_pin import FULL_PERCENT, MIN_PULSES_HZ, OutputPin


class VibrationMotorOptions(OutputPinOptions):
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


class GpiozeroVibrationMotor(PinActuator):
    """A vibration motor. From standstill it begins with a kick; the level is the one after that."""

    def __init__(self, options: VibrationMotorOptions, context: DriverContext) -> None:
        pin = OutputPin(context, options.pin, active_high=options.active_high, frequency_hz=options.frequency)
        super().__init__(pin, context)
        self._steps = DutySteps(options.minimum_duty)
        self._kick_s = options.kick
        self._kick_ends_s = -math.inf
        self._duty_percent = 0

    def _take_level(self, level: float, now_s: float) -> float:
        before, self._duty_percent = self._duty_percent, self._steps.percent(level)
        if before == 0:
            self._kick_ends_s = now_s + self._kick_s
        return self._steps.level(self._duty_percent)

    def _percent(self, now_s: float) -> int:
        kicks = self._duty_percent > 0 and now_s < self._kick_ends_s
        return FULL_PERCENT if kicks else self._duty_percent
