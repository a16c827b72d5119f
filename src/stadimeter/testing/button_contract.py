"""The contract of every button: subclass it with a fixture ``make_rig``, as `stadimeter.testing.rig` shows."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import pytest

from stadimeter.actuators.protocol import Button
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError
from stadimeter.testing.output_contract import raised_by
from stadimeter.testing.rig import Contract, Rig

ABSENT, FAILS = "absent", "fails"


@dataclass(frozen=True, slots=True, kw_only=True)
class ButtonRig(Rig[Button]):
    """A button with its device.

    Its faults are `ABSENT` (the device cannot be opened) and `FAILS` (whatever is read from it, the vendor's library
    raises its error).

    Attributes:
        press: Presses the button at the wire (True), or lets go of it.
        is_held: Whether the device is taken (a pin reserved), seen from outside of the driver.
    """

    press: Callable[[bool], None]
    is_held: Callable[[], bool]

    def is_pressed(self) -> bool:
        """Ask the driver, which must answer at once."""
        return bool(self.timed("is_pressed"))


class ButtonContract(Contract):
    """The tests."""

    def test_the_constructor_touches_no_hardware(self, rig: ButtonRig) -> None:
        assert not rig.is_held()

    def test_nobody_presses_it_at_first(self, opened: ButtonRig) -> None:
        assert opened.is_held()
        assert not opened.is_pressed()

    def test_it_is_pressed_for_as_long_as_it_is_held_down(self, opened: ButtonRig) -> None:
        for _ in range(2):
            opened.press(True)
            assert opened.is_pressed()
            assert opened.is_pressed()
            opened.press(False)
            assert not opened.is_pressed()

    def test_opening_it_while_it_is_held_down_says_so(self, rig: ButtonRig) -> None:
        rig.press(True)
        rig.device.open()
        assert rig.is_pressed()
        rig.device.close()

    def test_opening_and_closing_it_twice_is_once(self, rig: ButtonRig) -> None:
        rig.device.close()
        rig.device.open()
        rig.device.open()
        assert rig.is_held()
        rig.device.close()
        rig.device.close()
        assert not rig.is_held()

    def test_using_it_while_it_is_closed_raises(self, rig: ButtonRig) -> None:
        with pytest.raises(DeviceClosedError):
            rig.device.is_pressed()
        rig.device.open()
        rig.device.close()
        with pytest.raises(DeviceClosedError):
            rig.device.is_pressed()

    def test_one_that_cannot_be_opened_raises_and_is_not_held(self, rig: ButtonRig) -> None:
        rig.begin(ABSENT)
        assert isinstance(raised_by(rig.device.open), DeviceOpenError)
        rig.device.close()
        rig.end(ABSENT)
        assert not rig.is_held()
        rig.device.open()
        rig.press(True)
        assert rig.is_pressed()
        rig.device.close()

    def test_one_that_fails_raises_one_of_our_errors_and_can_be_opened_again(self, opened: ButtonRig) -> None:
        opened.begin(FAILS)
        error = raised_by(opened.device.is_pressed)
        assert error, "the device fails, and the driver does not notice"
        assert not isinstance(error, DeviceClosedError)
        with suppress(DriverError):
            opened.device.close()
        assert not opened.is_held()
        opened.end(FAILS)
        opened.device.open()
        opened.press(True)
        assert opened.is_pressed()
