from __future__ import annotations

import pytest
from gpiozero.pins.mock import MockFactory
from pydantic import ValidationError

from stadimeter.actuators.pin_actuator import GpiozeroSwitch, LedOptions, RelayOptions
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import LevelCommand


def led(context: DriverContext, **options: object) -> GpiozeroSwitch:
    lamp = LedOptions.model_validate({"pin": 24, **options}).build(context)
    lamp.open()
    return lamp


def relay(context: DriverContext, **options: object) -> GpiozeroSwitch:
    switch = RelayOptions.model_validate({"pin": 24, **options}).build(context)
    switch.open()
    return switch


def command(level: float) -> LevelCommand:
    return LevelCommand(output="it", level=level, captured_at_s=0.0)


@pytest.mark.parametrize(("level", "applied"), [(0.0, 0.0), (0.499, 0.0), (0.5, 1.0), (1.0, 1.0)])
def test_a_lamp_is_on_from_half_the_level(
    context: DriverContext, factory: MockFactory, level: float, applied: float
) -> None:
    lamp = led(context)
    assert lamp.apply(command(level)) == command(applied)
    assert factory.pin(24).state == applied
    assert factory.pin(24).frequency is None


def test_where_it_comes_on_can_be_chosen(context: DriverContext) -> None:
    lamp = led(context, on_at=0.9)
    assert lamp.apply(command(0.89)).level == 0.0
    assert lamp.apply(command(0.9)).level == 1.0


@pytest.mark.parametrize(("level", "applied"), [(0.0, 0.0), (0.004, 0.0), (0.005, 0.01), (0.29, 0.29), (0.996, 1.0)])
def test_a_dimmed_lamp_is_as_bright_as_the_nearest_percent(
    context: DriverContext, factory: MockFactory, level: float, applied: float
) -> None:
    lamp = led(context, dimmed=True, frequency="200 Hz")
    assert lamp.apply(command(level)).level == applied
    assert factory.pin(24).state == pytest.approx(applied)
    assert factory.pin(24).frequency == 200.0


def test_a_relay_is_switched_by_a_low_pin_unless_told_otherwise(context: DriverContext, factory: MockFactory) -> None:
    switch = relay(context)
    assert factory.pin(24).state == 1.0
    switch.apply(command(1.0))
    assert factory.pin(24).state == 0.0
    switch.stop()
    assert factory.pin(24).state == 1.0
    switch.close()
    other = relay(context, active_high=True)
    other.apply(command(1.0))
    assert factory.pin(24).state == 1.0


@pytest.mark.parametrize(
    "wrong",
    [{"dimmed": True, "on_at": 0.5}, {"dimmed": True, "frequency": "1 Hz"}, {"frequency": "200 Hz"}, {"on_at": 0.0}],
    ids=str,
)
def test_options_that_would_have_no_effect_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        LedOptions.model_validate({"pin": 24, **wrong})


def test_a_relay_cannot_be_dimmed() -> None:
    with pytest.raises(ValidationError):
        RelayOptions.model_validate({"pin": 24, "dimmed": True})
