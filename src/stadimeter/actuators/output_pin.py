"""One GPIO pin that something hangs on: what every driver of this folder is made of."""

from __future__ import annotations

import math

from gpiozero import DigitalOutputDevice, GPIODevice, PWMOutputDevice

from stadimeter.actuators.pin_factory import plain_words, shared_pin_factory
from stadimeter.config.plugins import DriverContext
from stadimeter.errors import DeviceClosedError, DeviceOpenError

FULL_PERCENT = 100


class OutputPin:
    """A pin that is off, on, or on for some percent of the time.

    The pin knows its polarity: 0 percent always means that what hangs on it is off.

    Closing leaves the pin as an input without a pull resistor, for that is how lgpio leaves it. What hangs on it must
    have a resistor of its own to its off side: to ground if it is active high, to 3.3 V if it is active low.

    Args:
        frequency_hz: Of the pulses, 0.1 to 10 000; None for a pin that is only ever off or on.
    """

    def __init__(
        self, context: DriverContext, pin: int, *, active_high: bool = True, frequency_hz: float | None = None
    ) -> None:
        self._context = context
        self._pin = pin
        self._active_high = active_high
        self._frequency_hz = frequency_hz
        self._device: DigitalOutputDevice | PWMOutputDevice | None = None
        self._written_percent: int | None = None

    @property
    def is_open(self) -> bool:
        """Whether the pin is ours."""
        return self._device is not None

    def check_open(self) -> None:
        """Raise unless the pin is open."""
        self._opened()

    def open(self) -> None:
        """Take the pin, off. Does nothing if it is open.

        Raises:
            DriverUnavailableError: lgpio is not installed.
            DeviceOpenError: There are no pins, or this one is in use.
        """
        if self._device is not None:
            return
        factory = shared_pin_factory(self._context)
        off = self._state(0)
        with plain_words(self._context.name, self._pin, "open", DeviceOpenError):
            if self._frequency_hz is None:
                self._device = DigitalOutputDevice(self._pin, initial_value=bool(off), pin_factory=factory)
            else:
                self._device = PWMOutputDevice(
                    self._pin, initial_value=off, frequency=self._frequency_hz, pin_factory=factory
                )
        self._written_percent = 0

    def write(self, percent: int) -> None:
        """Be on for that part of the time. Writing what is already there touches nothing.

        Args:
            percent: 0 for off to 100 for on; a pin without a frequency is on from 1.
        """
        if percent != self._written_percent or self._device is None:
            self._write_at_once(percent)

    def off(self) -> None:
        """Switch off, whatever was written before. Does nothing when closed."""
        if self._device is not None:
            self._write_at_once(0)

    def close(self) -> None:
        """Switch off and let go of the pin. May be called any number of times.

        Raises:
            DriverError: The pin failed; it is let go all the same.
        """
        device = self._device
        try:
            self.off()
        finally:
            self._device = self._written_percent = None
            if device is not None:
                self._let_go(device)

    def _write_at_once(self, percent: int) -> None:
        device = self._opened()
        self._written_percent = None  # not known while it may fail
        with plain_words(self._context.name, self._pin, "switch"):
            device.value = self._state(percent)
        self._written_percent = percent

    def _let_go(self, device: DigitalOutputDevice | PWMOutputDevice) -> None:
        with plain_words(self._context.name, self._pin, "let go of"):
            try:
                device.close()
            finally:
                # Where its pulses cannot be ended, a PWM device would keep the pin reserved for ever.
                GPIODevice.close(device)

    def _opened(self) -> DigitalOutputDevice | PWMOutputDevice:
        if self._device is None:
            raise DeviceClosedError(f"{self._context.name}: GPIO{self._pin} is not open; open the actuator first")
        return self._device

    def _state(self, percent: int) -> float:
        if self._frequency_hz is None and percent > 0:
            percent = FULL_PERCENT
        return duty(percent if self._active_high else FULL_PERCENT - percent)


def duty(percent: int) -> float:
    """Return the duty that lgpio turns into exactly this percentage.

    gpiozero hands ``int(value * 100)`` to lgpio, and 0.29 * 100 is 28.999…: one percent would be lost.

    Args:
        percent: 0 to 100.

    Returns:
        The smallest number, from 0 to 1, that is at least ``percent / 100`` and does not lose that percent.
    """
    value = percent / FULL_PERCENT
    return value if int(value * FULL_PERCENT) == percent else math.nextafter(value, 1.0)
