"""The ultrasonic sensor HC-SR04, and its like with a trigger and an echo pin.

The echo pin of most of them gives 5 V: a divider of two resistors keeps that from the Pi's pin, which takes 3.3 V.
"""

from __future__ import annotations

import math
import warnings
from typing import Any, ClassVar

from gpiozero import DistanceSensor, DistanceSensorNoEcho, PWMSoftwareFallback
from gpiozero.pins.pi import PiFactory

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Length, Pin
from stadimeter.core.clock import Clock
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError
from stadimeter.gpio.output_pin import pins_lack, plain_words, shared_pin_factory
from stadimeter.sensors.protocol import Echo

# The module's resolution is 3 mm; a pulse that Python times is late by some tens of microseconds, 1 cm. The speed of
# sound grows by 0.17 % a kelvin, and the room may be 12 K from the 20 °C that gpiozero assumes.
TIMING_SIGMA_M = 0.01
SOUND_RELATIVE_SIGMA = 0.02

# gpiozero pings every 60 ms and waits up to 100 ms for an answer. Three pings without one are no accident.
SILENT_AFTER_S = 0.5


class HcSr04Options(DriverOptions):
    """The options of an ultrasonic sensor HC-SR04: ± 1 cm and 2 %."""

    trigger: Pin
    """The BCM number of the pin that starts a measurement."""
    echo: Pin
    """The BCM number of the pin that hears its end, behind a divider from 5 V to 3.3 V."""
    max_range: Length = 4.0
    """In metres; what is further away counts as nothing."""

    def lacks(self) -> tuple[str, ...]:
        """List what this computer lacks to use pins. No pin is touched."""
        return pins_lack()

    def build(self, context: DriverContext) -> HcSr04:
        """Return the sensor."""
        return HcSr04(self, context)


class _Pings(DistanceSensor):  # type: ignore[misc] # gpiozero has no types
    """gpiozero's sensor, which measures in a thread of its own, and what its newest ping gave.

    gpiozero averages, and keeps its last value for ever when no echo comes: an obstacle that came near behind a cable
    that has come off would be as far away as before. So each answer is taken as it is, with its time.
    """

    newest: Echo | None = None

    def __init__(self, echo: int, trigger: int, range_m: float, clock: Clock, factory: PiFactory) -> None:
        self._clock = clock  # before the thread begins
        self._range_m = range_m
        super().__init__(echo, trigger, max_distance=range_m, queue_len=1, partial=True, pin_factory=factory)

    def _read(self) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DistanceSensorNoEcho)  # it is told by the age of the newest answer
            share = super()._read()
        if share is not None:
            distance_m = share * self._range_m
            sigma_m = math.hypot(TIMING_SIGMA_M, SOUND_RELATIVE_SIGMA * distance_m)
            if share >= 1.0:
                distance_m = math.inf
            self.newest = Echo(at_s=self._clock.now_s(), distance_m=distance_m, sigma_m=sigma_m)
        return share


class HcSr04:
    """A `RangeSensor` on two pins."""

    period_s: ClassVar = 0.05

    def __init__(self, options: HcSr04Options, context: DriverContext) -> None:
        self._options = options
        self._context = context
        self._pings: _Pings | None = None
        self._opened_at_s = 0.0

    def open(self) -> None:
        """Take the pins and begin to ping. Does nothing when open."""
        if self._pings is not None:
            return
        factory = shared_pin_factory(self._context)
        options = self._options
        with warnings.catch_warnings(), plain_words(self._context.name, self._options.echo, "open", DeviceOpenError):
            warnings.simplefilter("ignore", PWMSoftwareFallback)  # it advises pigpio, which cannot drive a Pi 5
            self._pings = _Pings(options.echo, options.trigger, options.max_range, self._context.clock, factory)
        self._opened_at_s = self._context.clock.now_s()

    def read(self) -> Echo | None:
        """Return the newest answer; a `LinkLostError` if there has been none for `SILENT_AFTER_S`."""
        if self._pings is None:
            raise DeviceClosedError(f"the sensor '{self._context.name}' is not open")
        newest = self._pings.newest
        last_s = self._opened_at_s if newest is None else newest.at_s
        if self._context.clock.now_s() - last_s > SILENT_AFTER_S:
            raise LinkLostError(
                f"the sensor '{self._context.name}' does not answer: check the cables to GPIO{self._options.trigger} "
                f"(trigger) and GPIO{self._options.echo} (echo), and that it gets 5 V"
            )
        return newest

    def close(self) -> None:
        """Let go of the pins. May be called any number of times."""
        pings, self._pings = self._pings, None
        if pings is not None:
            pings.close()
