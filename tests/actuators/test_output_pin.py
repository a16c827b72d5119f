from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest
from gpiozero.pins.mock import MockFactory, MockPin

from stadimeter.config.plugins import DriverContext
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError
from stadimeter.gpio.output_pin import OutputPin, duty
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
