from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import gpiozero
import pytest
from gpiozero.pins.mock import MockFactory, MockPin, MockPWMPin

from stadimeter.config.plugins import DriverContext
from stadimeter.errors import DeviceOpenError, DriverUnavailableError
from stadimeter.gpio.output_pin import open_pin_factory, shared_pin_factory
from stadimeter.testing.rig import ManualClock


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


def test_a_pi_whose_pins_cannot_be_opened_names_the_device_and_the_group(
    lgpio: Callable[[], ModuleType],
) -> None:
    open_pin_factory().close()
    lgpio().chips.clear()
    with pytest.raises(DeviceOpenError, match=r"can not open gpiochip.*/dev/gpiochip0.*group gpio"):
        open_pin_factory()


def test_mock_pins_can_be_dimmed_unless_another_kind_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GPIOZERO_PIN_FACTORY", "mock")
    monkeypatch.delenv("GPIOZERO_MOCK_PIN_CLASS", raising=False)
    assert open_pin_factory().pin_class is MockPWMPin
    monkeypatch.setenv("GPIOZERO_MOCK_PIN_CLASS", "mockpin")
    assert open_pin_factory().pin_class is MockPin


@pytest.mark.parametrize(
    ("variable", "value"), [("GPIOZERO_PIN_FACTORY", "pigpio"), ("GPIOZERO_MOCK_PIN_CLASS", "mokpin")]
)
def test_a_library_or_a_pin_that_is_not_known_is_refused(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str
) -> None:
    monkeypatch.setenv("GPIOZERO_PIN_FACTORY", "mock")
    monkeypatch.setenv(variable, value)
    with pytest.raises(DeviceOpenError, match=f"{variable}={value}.*unset the variable"):
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
