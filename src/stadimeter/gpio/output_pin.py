"""GPIO pins: one pin factory for a run, chosen on purpose, and the output pin that every driver on pins is made of.

gpiozero by itself tries one library after another, with a page of warnings, and may end at one that cannot drive this
Pi. Here it is lgpio, the only one that drives every Pi from the first to the fifth, or an error that says what to do.

A variable of the environment, gpiozero's own, chooses something else: ``GPIOZERO_PIN_FACTORY=mock`` drives pins that
exist in memory only, to try a configuration without hardware; ``lgpio``, or nothing, drives the real ones.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gpiozero import DigitalOutputDevice, GPIODevice, GPIOPinInUse, GPIOZeroError, PinUnknownPi, PWMOutputDevice
from gpiozero.pins.mock import MockFactory, MockPWMPin
from gpiozero.pins.pi import PiFactory

from stadimeter.config.extras import missing
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Pin
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError, DriverUnavailableError

# Under this name the drivers of a run share the factory; tests put a factory of their own there.
SHARED_KEY = "pin factory"

_TRY_WITHOUT = "to try without hardware, set GPIOZERO_PIN_FACTORY=mock"


def shared_pin_factory(context: DriverContext) -> PiFactory:
    """Return the run's pin factory; open it if this is the first driver to ask. It is closed at the end of the run.

    Give it to every gpiozero device: gpiozero's global one is never touched.

    Raises:
        DriverUnavailableError: lgpio is not installed.
        DeviceOpenError: This computer has no pins that we may use.
    """

    def make() -> PiFactory:
        factory = open_pin_factory()
        context.at_end(factory.close)
        return factory

    return context.share(SHARED_KEY, make)


def open_pin_factory() -> PiFactory:
    """Open the pin factory that the environment asks for: lgpio, if it asks for nothing. Close it when done.

    Raises:
        DriverUnavailableError: lgpio is not installed.
        DeviceOpenError: This computer has no pins that we may use, or the environment asks for another library.
    """
    name = _asked_for()
    if name == "lgpio":
        return _open_lgpio()
    if name == "mock":
        return MockFactory(pin_class=MockPWMPin)
    raise DeviceOpenError(_not_ours(name))


class PinOptions(DriverOptions):
    """The options of a driver with one pin."""

    pin: Pin
    """The BCM number of the pin."""

    def lacks(self) -> tuple[str, ...]:
        """List what this computer lacks to drive pins. No pin is touched."""
        return pins_lack()


def pins_lack() -> tuple[str, ...]:
    """List what this computer lacks to drive pins. No pin is touched."""
    name = _asked_for()
    if name == "mock":
        return ()
    if name != "lgpio":
        return (_not_ours(name),)
    if trouble := missing("pi"):
        return (f"pins are driven through lgpio: {trouble}; {_TRY_WITHOUT}",)
    if not any(Path("/dev").glob("gpiochip*")):
        return (f"this computer has no GPIO pins (no /dev/gpiochip0); {_TRY_WITHOUT}",)
    return ()


def _asked_for() -> str:
    return os.environ.get("GPIOZERO_PIN_FACTORY", "").lower() or "lgpio"


def _not_ours(name: str) -> str:
    return f"GPIOZERO_PIN_FACTORY={name}: pins are driven through lgpio only; unset the variable, or set it to mock"


def _open_lgpio() -> PiFactory:
    try:
        with _notification_pipe_elsewhere():
            from gpiozero.pins.lgpio import LGPIOFactory  # noqa: PLC0415 - absent where there are no pins
    except ImportError as error:
        raise DriverUnavailableError(
            f"pins are driven through lgpio: {missing('pi') or error}; {_TRY_WITHOUT}"
        ) from error
    except vendor_errors() as error:
        raise DeviceOpenError(f"lgpio does not start: {error}") from error
    try:
        return LGPIOFactory()
    except PinUnknownPi as error:
        raise DeviceOpenError(f"this computer is not a Raspberry Pi, it has no GPIO pins; {_TRY_WITHOUT}") from error
    except vendor_errors() as error:
        raise DeviceOpenError(
            f"the GPIO pins cannot be opened ({_text(error)}): there must be a /dev/gpiochip0, and the user must be in "
            f"the group gpio (sudo usermod -aG gpio $USER, then log in again); {_TRY_WITHOUT}"
        ) from error


@contextmanager
def _notification_pipe_elsewhere() -> Iterator[None]:
    """Import lgpio in here, so that it leaves nothing behind and changes nothing.

    On import lgpio makes a named pipe in the working directory, and fails where it may not write. If ``LG_WD``
    names another directory, it makes that one the working directory of the whole program, which would break every
    relative path. Once lgpio has opened the pipe at both ends, its name is no longer needed.
    """
    here, asked = Path.cwd(), os.environ.get("LG_WD")
    with tempfile.TemporaryDirectory(prefix="stadimeter-lgpio-") as folder:
        os.environ["LG_WD"] = folder
        try:
            yield
        finally:
            os.chdir(here)
            if asked is None:
                del os.environ["LG_WD"]
            else:
                os.environ["LG_WD"] = asked


def vendor_errors() -> tuple[type[Exception], ...]:
    """List what gpiozero and lgpio raise, for an ``except`` clause; lgpio's own is there only while lgpio is."""
    lgpio = sys.modules.get("lgpio")
    return (GPIOZeroError, OSError) if lgpio is None else (GPIOZeroError, OSError, lgpio.error)


@contextmanager
def plain_words(name: str, pin: int, doing: str, raises: type[DriverError] = DriverError) -> Iterator[None]:
    """Raise the vendors' errors as ``raises``, a `DriverError`; ``doing`` is what is being tried, such as ``open``."""
    try:
        yield
    except vendor_errors() as error:
        # A half-made gpiozero device keeps its pin reserved for as long as something refers to it, and the error does.
        traceback.clear_frames(error.__traceback__)
        raise raises(f"{name}: cannot {doing} GPIO{pin}: {_text(error)}{_hint(error)}") from error


def _text(error: Exception) -> str:
    return " ".join(str(error).strip("'\"").split()) or type(error).__name__


def _hint(error: Exception) -> str:
    if isinstance(error, GPIOPinInUse):
        return "; give each part of the configuration a pin of its own"
    if "busy" in str(error).lower():
        return "; another program holds it, or the system, as for SPI or 1-Wire: `stadimeter doctor CONFIG` says which"
    return ""


FULL_PERCENT = 100

# lgpio begins a new duty, off among them, where a pulse ends: at 1 Hz a stop would take a second, and here 50 ms.
MIN_PULSES_HZ = 20.0


class OutputPin:
    """A pin that is off, on, or on for some percent of the time.

    The pin knows its polarity: 0 percent always means that what hangs on it is off.

    Closing leaves the pin as an input without a pull resistor, for that is how lgpio leaves it. What hangs on it must
    have a resistor of its own to its off side: to ground if it is active high, to 3.3 V if it is active low.

    Args:
        frequency_hz: Of the pulses, 20 to 10 000; None for a pin that is only ever off or on.
        factory: Where the pin comes from; None for the run's pin factory.
    """

    def __init__(
        self,
        context: DriverContext,
        pin: int,
        *,
        active_high: bool = True,
        frequency_hz: float | None = None,
        factory: Callable[[], PiFactory] | None = None,
    ) -> None:
        self._context = context
        self._factory = factory or (lambda: shared_pin_factory(context))
        self._pin = pin
        self._active_high = active_high
        self._frequency_hz = frequency_hz
        self._device: DigitalOutputDevice | PWMOutputDevice | None = None
        self._written_percent: int | None = None

    def check_open(self) -> DigitalOutputDevice | PWMOutputDevice:
        """Return the device, or raise `DeviceClosedError` unless the pin is open."""
        if self._device is None:
            raise DeviceClosedError(f"{self._context.name}: GPIO{self._pin} is not open; open its driver first")
        return self._device

    def open(self) -> None:
        """Take the pin, off. Does nothing if it is open."""
        if self._device is not None:
            return
        factory = self._factory()
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
        """Be on for 0 to 100 percent of the time (without a frequency: on from 1). A repeated write does nothing."""
        if percent != self._written_percent or self._device is None:
            self.rewrite(percent)

    def off(self) -> None:
        """Switch off, whatever was written before; raises `DriverError` if the pin fails. Does nothing when closed."""
        if self._device is not None:
            self.rewrite(0)

    def close(self) -> None:
        """Switch off and let go of the pin, even if it fails. May be called any number of times."""
        device = self._device
        try:
            self.off()
        finally:
            self._device = self._written_percent = None
            if device is not None:
                self._let_go(device)

    def rewrite(self, percent: int) -> None:
        """Write, also what was written before; raises `DriverError` if the pin fails."""
        device = self.check_open()
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

    def _state(self, percent: int) -> float:
        if self._frequency_hz is None and percent > 0:
            percent = FULL_PERCENT
        return duty(percent if self._active_high else FULL_PERCENT - percent)


def duty(percent: int) -> float:
    """Return the smallest duty, 0 to 1, that lgpio turns into exactly this percentage.

    gpiozero hands ``int(value * 100)`` to lgpio, and 0.29 * 100 is 28.999…: one percent would be lost.
    """
    value = percent / FULL_PERCENT
    return value if int(value * FULL_PERCENT) == percent else math.nextafter(value, 1.0)
