"""The contract that actuators and bases share: taking and releasing the device, coming to rest, failing."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError
from stadimeter.testing.rig import Contract, OutputRig

AnyRig = OutputRig[Any]


class OutputContract(Contract):
    """The tests. Subclasses name the faults that their devices may have."""

    @pytest.fixture
    def opening_fault(self) -> str:
        """Return each fault that keeps the device from being opened. Override it with params."""
        raise NotImplementedError

    @pytest.fixture
    def fault(self) -> str:
        """Return each fault that may come up in use. Override it with params."""
        raise NotImplementedError

    def test_it_opens_at_rest_and_takes_the_device_once(self, rig: AnyRig) -> None:
        """The constructor touches no hardware. What a second `open` took besides would stay taken for ever."""
        assert not rig.is_held()
        rig.device.open()
        rig.device.open()
        assert rig.is_held()
        assert rig.rests()
        rig.pass_time_s(1.0, lambda: pytest.fail("it acts without a command") if not rig.rests() else None)
        rig.device.close()
        assert not rig.is_held()

    def test_it_acts_and_ticks_without_keeping_the_loop_waiting(self, opened: AnyRig) -> None:
        opened.act()
        assert not opened.rests()
        opened.pass_time_s(0.1)

    def test_stop_brings_it_to_rest_and_does_not_latch(self, opened: AnyRig) -> None:
        opened.act()
        opened.device.stop()
        assert opened.comes_to_rest()
        opened.act()
        assert not opened.rests()

    def test_using_it_while_it_is_closed_raises(self, rig: AnyRig) -> None:
        """Stopping and closing it does nothing: cleaning up does not depend on what was opened."""
        for _ in range(2):
            self._check_unusable(rig)
            rig.device.stop()
            rig.device.close()
            assert not rig.is_held()
            rig.device.open()
            rig.device.close()

    def test_close_stops_first_and_it_can_be_opened_again(self, opened: AnyRig) -> None:
        """Everything it did before is forgotten, and it works."""
        opened.act()
        opened.device.close()
        assert opened.comes_to_rest()
        assert not opened.is_held()
        opened.device.close()
        opened.device.open()
        assert opened.is_held()
        opened.pass_time_s(1.0)
        assert opened.rests()
        opened.act()
        assert not opened.rests()

    def test_a_device_that_cannot_be_opened_raises_and_is_not_held(self, rig: AnyRig, opening_fault: str) -> None:
        rig.begin(opening_fault)
        assert isinstance(raised_by(rig.device.open), DeviceOpenError)
        rig.device.stop()
        rig.device.close()
        rig.end(opening_fault)
        rig.clock.advance_s(rig.settles_s)
        assert not rig.is_held()
        rig.device.open()
        rig.device.close()

    def test_a_device_that_fails_raises_one_of_our_errors(self, opened: AnyRig, fault: str) -> None:
        opened.act()
        opened.begin(fault)
        error = raised_by(lambda: self._use(opened))
        assert error, "the device fails, and the driver does not notice"
        assert not isinstance(error, DeviceClosedError)
        for call in (opened.device.stop, opened.tick, opened.device.close):
            raised_by(call)

    def test_a_device_that_failed_is_released_all_the_same_and_works_again(self, opened: AnyRig, fault: str) -> None:
        opened.act()
        opened.begin(fault)
        with suppress(DriverError):
            self._use(opened)
        with suppress(DriverError):
            opened.device.close()
        assert not opened.is_held()
        opened.end(fault)
        opened.clock.advance_s(opened.settles_s)
        opened.device.open()
        opened.pass_time_s(1.0)
        assert opened.rests()
        opened.act()
        assert not opened.rests()

    def _use(self, rig: AnyRig) -> None:
        """Use the device for as long as it may take to notice that it fails."""
        raise NotImplementedError

    def _check_unusable(self, rig: AnyRig) -> None:
        with pytest.raises(DeviceClosedError):
            rig.act()
        with pytest.raises(DeviceClosedError):
            rig.device.tick(rig.clock.now_s())
        assert not rig.is_held()


def raised_by(call: Callable[[], object]) -> DriverError | None:
    """Call, and return the error of the driver's interface that came; None for none. Any other error fails the test."""
    try:
        call()
    except DriverError as error:
        if error.__cause__ is None and not isinstance(error.__context__, DriverError | None):
            pytest.fail(f"{error!r} hides {error.__context__!r}, from which it was made: write `raise … from error`")
        return error
    except Exception as error:  # noqa: BLE001 - whatever the vendor raises
        pytest.fail(f"{type(error).__name__}: {error}: this is the vendor's error; raise a DriverError from it")
    return None
