"""The actuators on one pin: a lamp or a relay, a buzzer, a vibration motor."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, Self

from msgspec.structs import replace
from pydantic import Field, model_validator

from stadimeter.config.plugins import DriverContext
from stadimeter.config.units import Frequency
from stadimeter.core.command import LevelCommand
from stadimeter.gpio.output_pin import FULL_PERCENT, MIN_PULSES_HZ, OutputPin, PinOptions

# An actuator on one pin, and its options ------------------------------------------------------------------------------


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


# Things that are on or off: a lamp, which may also be dimmed, and a relay ---------------------------------------------


class LedOptions(OutputPinOptions):
    """The options of a lamp."""

    verb: ClassVar = "lights"
    circuit: ClassVar = "led"

    dimmed: bool = False
    """Whether it is as bright as the level says, instead of on or off."""
    frequency: Frequency = Field(default=100.0, ge=MIN_PULSES_HZ, le=10_000.0)
    """Of the pulses that dim it: below 20 Hz it would blink, and go off late."""

    @model_validator(mode="after")
    def _one_way_only(self) -> Self:
        if not self.dimmed and "frequency" in self.model_fields_set:
            raise ValueError("frequency has no meaning with dimmed = false; leave it out")
        return self

    def build(self, context: DriverContext) -> GpiozeroSwitch:
        """Return the lamp."""
        frequency_hz = self.frequency if self.dimmed else None
        pin = OutputPin(context, self.pin, active_high=self.active_high, frequency_hz=frequency_hz)
        return GpiozeroSwitch(pin, context, is_dimmed=self.dimmed)


class RelayOptions(OutputPinOptions):
    """The options of a relay."""

    verb: ClassVar = "switches on"
    circuit: ClassVar = "relay"

    active_high: bool = False
    """Whether a high pin means on. Most relay boards switch on when their input is pulled low, so it is not unless you
    say so. Try it without a load first: with the wrong value the relay is on while all is quiet."""

    def build(self, context: DriverContext) -> GpiozeroSwitch:
        """Return the relay."""
        return GpiozeroSwitch(OutputPin(context, self.pin, active_high=self.active_high), context)


class GpiozeroSwitch(PinActuator):
    """Something on a pin that is on or off, or as bright as the level says, in whole percents.

    It has no deadband of its own: rules that switch have theirs, and delays too.

    Args:
        is_dimmed: Whether it is as bright as the level says. Else it is on from half the level.
    """

    def __init__(self, pin: OutputPin, context: DriverContext, *, is_dimmed: bool = False) -> None:
        super().__init__(pin, context)
        self._is_dimmed = is_dimmed
        self._share = 0.0

    def _take_level(self, level: float, now_s: float) -> float:  # noqa: ARG002 - a switch has no pattern
        percent = math.floor(level * FULL_PERCENT + 0.5)
        self._share = percent / FULL_PERCENT if self._is_dimmed else float(level >= 0.5)
        return self._share

    def _percent(self, now_s: float) -> int:  # noqa: ARG002
        return round(self._share * FULL_PERCENT)


# An active buzzer: one that sounds by itself when it gets power -------------------------------------------------------


# From one beep to the next at the lowest level above 0, and just below the full one; and how long a beep is: less than
# two ticks might fall between them.
SLOWEST_S, FASTEST_S, BEEP_S = 1.0, 0.1, 0.05


class BeepPattern:
    """Beeps of one length whose rate follows a level, as in a parking sensor.

    The period goes from the slowest to the fastest in equal ratios: a step of level sounds like the same step
    everywhere. A change of level moves the next beep, never the one that sounds.
    """

    def __init__(self) -> None:
        self._started_s: float | None = None

    def period_s(self, level: float) -> float:
        """Return the time from one beep's start to the next one's: ``SLOWEST_S * (FASTEST_S / SLOWEST_S) ** level``."""
        return float(SLOWEST_S * (FASTEST_S / SLOWEST_S) ** level)

    def sounds(self, level: float, now_s: float) -> bool:
        """Move on to a time and return whether it sounds then. Asking twice for one time gives the same answer.

        Args:
            level: 0 is silent, and the first level above it beeps at once; 1 sounds without a break.
        """
        if level <= 0.0:
            self._started_s = None
            return False
        self._started_s = self._newest_start_s(self.period_s(level), now_s)
        return level >= 1.0 or now_s - self._started_s < BEEP_S

    def _newest_start_s(self, period_s: float, now_s: float) -> float:
        if self._started_s is None:
            return now_s
        due_s = self._started_s + period_s
        if now_s < due_s:
            return self._started_s
        # Counted from when it was due, so that late ticks do not slow the beeping down, but never so far back that
        # the beep would be over before it was heard.
        return due_s if now_s - due_s < BEEP_S / 2 else now_s


class BuzzerOptions(OutputPinOptions):
    """The options of a buzzer."""

    verb: ClassVar = "buzzes"
    circuit: ClassVar = "buzzer"

    steady: bool = False
    """Sound without a break at any level above 0."""

    def build(self, context: DriverContext) -> GpiozeroBuzzer:
        """Return the buzzer."""
        return GpiozeroBuzzer(self, context)


class GpiozeroBuzzer(PinActuator):
    """A buzzer. Level 0 is silent, a rising level beeps faster, and 1 sounds without a break.

    A beep that sounds is not begun anew. A steady buzzer only knows 0 and 1.
    """

    def __init__(self, options: BuzzerOptions, context: DriverContext) -> None:
        super().__init__(OutputPin(context, options.pin, active_high=options.active_high), context)
        self._pattern = BeepPattern()
        self._steady = options.steady
        self._level = 0.0

    def _take_level(self, level: float, now_s: float) -> float:
        self._level = float(level > 0.0) if self._steady else level
        self._pattern.sounds(self._level, now_s)
        return self._level

    def _percent(self, now_s: float) -> int:
        return FULL_PERCENT if self._pattern.sounds(self._level, now_s) else 0


# A vibration motor behind a transistor on a pin with pulse-width modulation -------------------------------------------


class VibrationMotorOptions(OutputPinOptions):
    """The options of a vibration motor."""

    verb: ClassVar = "vibrates"
    circuit: ClassVar = "motor"

    frequency: Frequency = Field(default=100.0, ge=MIN_PULSES_HZ, le=10_000.0)
    """Of the pulses, which lgpio makes in software, up to 10 kHz; the higher, the less even they are. A stop waits for
    the end of a pulse: 50 ms at 20 Hz."""
    minimum_duty: float = Field(default=0.4, gt=0.0, le=1.0)
    """The motor's weakest duty. Eccentric motors do not turn below 40 to 50 percent."""

    def build(self, context: DriverContext) -> GpiozeroVibrationMotor:
        """Return the motor."""
        return GpiozeroVibrationMotor(self, context)


# For how long a motor that stands still gets full power, to break loose.
KICK_S = 0.08


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
        self._kick_ends_s = -math.inf
        self._duty_percent = 0

    def _take_level(self, level: float, now_s: float) -> float:
        before, self._duty_percent = self._duty_percent, self._steps.percent(level)
        if before == 0:
            self._kick_ends_s = now_s + KICK_S
        return self._steps.level(self._duty_percent)

    def _percent(self, now_s: float) -> int:
        kicks = self._duty_percent > 0 and now_s < self._kick_ends_s
        return FULL_PERCENT if kicks else self._duty_percent
