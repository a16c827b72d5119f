"""Pins for tests: in memory, where they remember; and an lgpio that remembers, on a Raspberry Pi that is none."""

from __future__ import annotations

import errno
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from gpiozero.pins.mock import MockFactory, MockPWMPin

from stadimeter.config.plugins import DriverContext
from stadimeter.gpio.output_pin import SHARED_KEY

PRETEND = Path(__file__).parent / "pretend"
LGPIO_MODULES = ("lgpio", "gpiozero.pins.lgpio")


@pytest.fixture
def pretended_pi(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let `import lgpio` find the pretended one, on a pretended Raspberry Pi 3."""
    monkeypatch.delenv("GPIOZERO_PIN_FACTORY", raising=False)
    monkeypatch.syspath_prepend(str(PRETEND))
    monkeypatch.setattr("gpiozero.pins.local.get_pi_revision", lambda: 0xA02082)
    real = {name: sys.modules.pop(name) for name in LGPIO_MODULES if name in sys.modules}
    yield
    for name in LGPIO_MODULES:
        sys.modules.pop(name, None)
    sys.modules.update(real)


@pytest.fixture
def lgpio(pretended_pi: None) -> Callable[[], ModuleType]:
    """Return a function that returns the pretended lgpio, once a driver has imported it."""
    return lambda: sys.modules["lgpio"]


class WatchedPin(MockPWMPin):  # type: ignore[misc] # gpiozero has no types
    """A pin in memory that remembers what it did when it was let go: as an input it no longer drives anything.

    Attributes:
        released: What it did when it was let go, from 0, low, to 1, high; None while it is an output.
        is_failing: Fault: whatever is written or read raises an `OSError`, as a chip that does not answer does.
        is_grounded: Whether something joins it to ground, so that no resistor pulls it up.
    """

    released: float | None = None
    is_failing = False
    is_grounded = False

    def close(self) -> None:
        """Become an input."""
        self._remember()
        super().close()

    def _set_state(self, value: float) -> None:
        if self.is_failing:
            raise OSError(errno.EIO, "the pin does not answer")
        super()._set_state(value)

    def _get_state(self) -> float:
        if self.is_failing and self._function == "input":
            raise OSError(errno.EIO, "the pin does not answer")
        return 0.0 if self.is_grounded else float(super()._get_state())

    def _set_frequency(self, value: float | None) -> None:
        if value is None and self._frequency is not None:
            self._remember()
        super()._set_frequency(value)

    def _set_function(self, value: str) -> None:
        super()._set_function(value)
        if value == "output":
            self.released = None

    def _remember(self) -> None:
        if self._function == "output" and self.released is None:
            self.released = self._state


class _OtherProgram:
    """Holds a pin that a driver wants."""


class WatchedPins:
    """One run's pins in memory, for the drivers of a context that use gpiozero."""

    def __init__(self, context: DriverContext) -> None:
        self._factory = context.share(SHARED_KEY, lambda: MockFactory(pin_class=WatchedPin))
        self._other_program = _OtherProgram()

    def state(self, pin: int) -> float:
        """Return the state of a pin, from 0, low, to 1, high; for one that was let go, what it did then."""
        watched = self._factory.pin(pin)
        return float(watched.state if watched.released is None else watched.released)

    def is_held(self) -> bool:
        """Check whether a driver has reserved any pin or drives one."""
        reservations = self._factory._reservations.values()
        holders = [reference() for references in reservations for reference in references]
        reserved = any(holder not in {None, self._other_program} for holder in holders)
        driven = any(pin.function == "output" for pin in self._factory.pins.values())
        return bool(reserved or driven)

    def ground(self, pin: int, *, begins: bool) -> None:
        """Join a pin to ground, as a button does that is pressed, or let go of it."""
        self._factory.pin(pin).is_grounded = begins

    def occupy(self, pin: int, *, begins: bool) -> None:
        """Begin or end the fault that something else has taken a pin."""
        if begins:
            self._factory.reserve_pins(self._other_program, pin)
        else:
            self._factory.release_pins(self._other_program, pin)

    def fail(self, pin: int, *, begins: bool) -> None:
        """Begin or end the fault that a pin cannot be written, nor read."""
        self._factory.pin(pin).is_failing = begins
