"""A push button: the one part on a pin that is read."""

from __future__ import annotations

from typing import ClassVar

from gpiozero import InputDevice

from stadimeter.config.plugins import DriverContext
from stadimeter.errors import DeviceClosedError, DeviceOpenError
from stadimeter.gpio.output_pin import PinOptions, plain_words, shared_pin_factory


class ButtonOptions(PinOptions):
    """The options of a button. It joins its pin to ground; the Pi's own resistor pulls that up."""

    circuit: ClassVar = "button"

    def build(self, context: DriverContext) -> GpiozeroButton:
        """Return the button."""
        return GpiozeroButton(self, context)


class GpiozeroButton:
    """A button between a pin and ground. A cable that is cut, or comes off, reads as not pressed."""

    def __init__(self, options: ButtonOptions, context: DriverContext) -> None:
        self._pin = options.pin
        self._context = context
        self._device: InputDevice | None = None

    def open(self) -> None:
        """Take the pin as an input with its pull-up. Does nothing if it is open."""
        if self._device is None:
            factory = shared_pin_factory(self._context)
            with plain_words(self._context.name, self._pin, "open", DeviceOpenError):
                self._device = InputDevice(self._pin, pull_up=True, pin_factory=factory)

    def is_pressed(self) -> bool:
        """Read the pin."""
        if self._device is None:
            raise DeviceClosedError(f"{self._context.name}: GPIO{self._pin} is not open; open the button first")
        with plain_words(self._context.name, self._pin, "read"):
            return bool(self._device.is_active)

    def close(self) -> None:
        """Let go of the pin. May be called any number of times."""
        device, self._device = self._device, None
        if device is not None:
            with plain_words(self._context.name, self._pin, "let go of"):
                device.close()
