"""Output pins, and the factory that the drivers of a run share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import gpiozero
import pytest
from gpiozero.pins.mock import MockFactory, MockPin

from stadimeter.config.plugins import DriverContext
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError, DriverUnavailableError
from stadimeter.gpio.output_pin import OutputPin, duty, open_pin_factory, shared_pin_factory
from stadimeter.testing.rig import ManualClock


def is_open(pin: OutputPin) -> bool:
    try:
        pin.check_open()
    except DeviceClosedError:
        return False
    return True


def states(factory: MockFactory, pin: int) -> list[float]:
    return [state for _, state in factory.pin(pin).states]


def test_truncation_as_gpiozero_does_it_for_lgpio_loses_no_percent() -> None:
    assert [int(duty(percent) * 100) for percent in range(101)] == list(range(101))
    assert [duty(percent) for percent in range(101)] == pytest.approx([percent / 100 for percent in range(101)])
    assert int(29 / 100 * 100) == 28, "if this fails, the trap is gone, and so may duty() be"


@pytest.mark.parametrize("active_high", [True, False])
@pytest.mark.parametrize("percent", [0, 1, 29, 42, 43, 57, 58, 71, 99, 100])
def test_lgpio_is_given_the_percent_that_is_meant(
    clock: ManualClock, lgpio: Callable[[], ModuleType], active_high: bool, percent: int
) -> None:
    context = DriverContext(name="motor", clock=clock)
    pin = OutputPin(context, 18, active_high=active_high, frequency_hz=250.0)
    pin.open()
    pin.write(percent)
    assert lgpio().pulses[18] == (250.0, percent if active_high else 100 - percent)
    pin.close()
    assert lgpio().modes[18] == "input"
    assert 18 not in lgpio().pulses
    context.shared.closers.pop()()


def test_writing_what_is_there_touches_nothing_but_switching_off_always_writes(
    monkeypatch: pytest.MonkeyPatch, clock: ManualClock, lgpio: Callable[[], ModuleType]
) -> None:
    context = DriverContext(name="motor", clock=clock)
    pin = OutputPin(context, 18)
    pin.open()
    written: list[int] = []
    monkeypatch.setattr(lgpio(), "gpio_write", lambda _handle, _gpio, level: written.append(level))
    for percent in (0, 100, 100, 100, 0, 0):
        pin.write(percent)
    assert written == [True, False]
    pin.off()
    assert written == [True, False, False]
    pin.close()
    context.shared.closers.pop()()


def test_a_pin_of_another_part_is_refused_in_plain_words_and_free_again_later(context: DriverContext) -> None:
    first, second = OutputPin(context, 18), OutputPin(context, 18, frequency_hz=100.0)
    first.open()
    with pytest.raises(DeviceOpenError, match=r"motor: cannot open GPIO18: .*in use.*a pin of its own") as caught:
        second.open()
    assert not is_open(second)
    first.close()
    second.open()
    assert caught.value.__cause__ is not None


def test_a_pin_that_another_program_holds_is_refused_with_a_hint_and_may_be_tried_again(
    clock: ManualClock, lgpio: Callable[[], ModuleType]
) -> None:
    context = DriverContext(name="motor", clock=clock)
    OutputPin(context, 4).open()
    lgpio().busy.add(18)
    pin = OutputPin(context, 18)
    with pytest.raises(DeviceOpenError, match=r"motor: cannot open GPIO18: GPIO busy; another program.*SPI") as caught:
        pin.open()
    assert not is_open(pin)
    lgpio().busy.clear()
    pin.open()
    assert is_open(pin)
    assert caught.value.__cause__ is not None, "the error is still there, and must not keep the pin reserved"
    pin.close()
    context.shared.closers.pop()()


def test_a_pin_without_pulses_is_refused_for_dimming(clock: ManualClock) -> None:
    context = DriverContext(name="lamp", clock=clock)
    context.share("pin factory", lambda: MockFactory(pin_class=MockPin))
    with pytest.raises(DeviceOpenError, match="lamp: cannot open GPIO18: PinPWMUnsupported"):
        OutputPin(context, 18, frequency_hz=100.0).open()


@pytest.mark.parametrize("frequency_hz", [None, 100.0])
def test_a_pin_that_fails_says_so_is_tried_again_and_is_let_go_all_the_same(
    clock: ManualClock, lgpio: Callable[[], ModuleType], frequency_hz: float | None
) -> None:
    context = DriverContext(name="motor", clock=clock)
    pin = OutputPin(context, 18, frequency_hz=frequency_hz)
    pin.open()
    lgpio().broken.add(18)
    with pytest.raises(DriverError, match="motor: cannot switch GPIO18: "):
        pin.write(100)
    with pytest.raises(DriverError):
        pin.write(0)  # not skipped, although 0 was the last to arrive
    with pytest.raises(DriverError):
        pin.close()
    assert not is_open(pin)
    pin.close()
    lgpio().broken.clear()
    pin.open()
    pin.write(100)
    pin.close()
    context.shared.closers.pop()()


def test_a_closed_pin_can_be_switched_off_but_not_written(context: DriverContext, factory: MockFactory) -> None:
    pin = OutputPin(context, 18)
    pin.off()
    with pytest.raises(DeviceClosedError, match="motor: GPIO18 is not open"):
        pin.write(0)
    pin.open()
    pin.close()
    with pytest.raises(DeviceClosedError):
        pin.write(0)
    assert set(states(factory, 18)) == {0.0}


@pytest.fixture
def fresh_context(clock: ManualClock) -> DriverContext:
    return DriverContext(name="motor", clock=clock)


def close_all(context: DriverContext) -> None:
    while context.shared.closers:
        context.shared.closers.pop()()


@pytest.mark.parametrize("name", [None, "", "lgpio", "LGPIO"])
def test_the_pins_are_driven_through_lgpio_unless_told_otherwise(
    monkeypatch: pytest.MonkeyPatch, lgpio: Callable[[], ModuleType], name: str | None
) -> None:
    if name is not None:
        monkeypatch.setenv("GPIOZERO_PIN_FACTORY", name)
    factory = open_pin_factory()
    assert type(factory).__name__ == "LGPIOFactory"
    assert lgpio().opened == [0]
    factory.close()
    assert lgpio().opened == []


def test_importing_lgpio_leaves_no_pipe_behind_and_the_working_directory_alone(
    monkeypatch: pytest.MonkeyPatch, lgpio: Callable[[], ModuleType], tmp_path: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    working = tmp_path / "working"
    working.mkdir()
    monkeypatch.chdir(working)
    open_pin_factory().close()
    assert Path.cwd() == working
    assert list(tmp_path.iterdir()) == [working]
    assert list(working.iterdir()) == []
    assert "LG_WD" not in os.environ


def test_a_pipe_directory_that_the_user_asked_for_stays_in_the_environment(
    monkeypatch: pytest.MonkeyPatch, lgpio: Callable[[], ModuleType], tmp_path: Path
) -> None:
    monkeypatch.setenv("LG_WD", str(tmp_path))
    open_pin_factory().close()
    assert os.environ["LG_WD"] == str(tmp_path)


def test_without_lgpio_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GPIOZERO_PIN_FACTORY", raising=False)
    monkeypatch.delitem(sys.modules, "gpiozero.pins.lgpio", raising=False)
    monkeypatch.setitem(sys.modules, "lgpio", None)
    with pytest.raises(DriverUnavailableError, match=r"pip install 'stadimeter\[pi\]'") as caught:
        open_pin_factory()
    assert "\n" not in str(caught.value)


def test_a_computer_that_is_no_pi_is_told_how_to_try_without_pins(
    monkeypatch: pytest.MonkeyPatch, pretended_pi: None
) -> None:
    def unknown() -> int:
        raise gpiozero.PinUnknownPi("unable to locate Pi revision in /proc/device-tree or /proc/cpuinfo")

    monkeypatch.setattr("gpiozero.pins.local.get_pi_revision", unknown)
    with pytest.raises(DeviceOpenError, match=r"not a Raspberry Pi.*GPIOZERO_PIN_FACTORY=mock"):
        open_pin_factory()


def test_a_pi_whose_pins_cannot_be_opened_names_the_device_and_the_group(lgpio: Callable[[], ModuleType]) -> None:
    open_pin_factory().close()
    lgpio().chips.clear()
    with pytest.raises(DeviceOpenError, match=r"can not open gpiochip.*/dev/gpiochip0.*group gpio"):
        open_pin_factory()


def test_the_drivers_of_a_run_share_one_factory_and_gpiozeros_own_is_not_touched(
    monkeypatch: pytest.MonkeyPatch, fresh_context: DriverContext
) -> None:
    monkeypatch.setenv("GPIOZERO_PIN_FACTORY", "mock")
    before = gpiozero.Device.pin_factory
    factory = shared_pin_factory(fresh_context)
    assert isinstance(factory, MockFactory)
    assert shared_pin_factory(fresh_context) is factory
    assert gpiozero.Device.pin_factory is before


def test_the_factory_is_closed_once_at_the_end_of_the_run(
    fresh_context: DriverContext, lgpio: Callable[[], ModuleType]
) -> None:
    shared_pin_factory(fresh_context)
    shared_pin_factory(fresh_context)
    assert lgpio().opened == [0]
    close_all(fresh_context)
    assert lgpio().opened == []


def test_a_factory_that_could_not_be_opened_is_tried_again(
    fresh_context: DriverContext, lgpio: Callable[[], ModuleType]
) -> None:
    open_pin_factory().close()
    lgpio().chips.clear()
    with pytest.raises(DeviceOpenError):
        shared_pin_factory(fresh_context)
    lgpio().chips.add(0)
    shared_pin_factory(fresh_context)
    close_all(fresh_context)
