from __future__ import annotations

import pytest
from gpiozero.pins.mock import MockFactory
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from stadimeter.actuators.pin_actuator import DutySteps, GpiozeroVibrationMotor, VibrationMotorOptions
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import LevelCommand
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case


def make(context: DriverContext, **options: object) -> GpiozeroVibrationMotor:
    motor = GpiozeroVibrationMotor(VibrationMotorOptions.model_validate({"pin": 18, **options}), context)
    motor.open()
    return motor


def command(level: float) -> LevelCommand:
    return LevelCommand(output="motor", level=level, captured_at_s=0.0)


def states(factory: MockFactory) -> list[float]:
    return [state for _, state in factory.pin(18).states]


@each_case(("level", "percent"), [(0.0, 0), (1e-9, 40), (0.02, 40), (0.25, 54), (0.5, 70), (0.99, 99), (1.0, 100)])
def test_levels_above_zero_are_spread_over_the_duties_from_the_weakest_to_full(level: float, percent: int) -> None:
    assert DutySteps(0.4).percent(level) == percent


@given(minimum=st.floats(0.001, 1.0), level=st.floats(0.0, 1.0))
def test_a_duty_stands_for_the_level_nearest_to_the_one_that_was_asked_for(minimum: float, level: float) -> None:
    steps = DutySteps(minimum)
    percent = steps.percent(level)
    assert percent == 0 or minimum * 100 - 1e-6 <= percent <= 100
    assert steps.percent(steps.level(percent)) == percent
    assert (steps.level(percent) == 0.0) == (level == 0.0)
    step = 1.0 / (101 - min(steps.percent(1e-9), 100))
    assert abs(steps.level(percent) - level) <= step / 2 + 1e-9 or percent == steps.percent(1e-9)


def test_a_motor_that_stands_still_is_kicked_for_exactly_as_long_as_configured(
    context: DriverContext, factory: MockFactory, clock: ManualClock
) -> None:
    motor = make(context)
    assert motor.apply(command(0.5)).level == pytest.approx(0.5, abs=0.01)
    assert factory.pin(18).frequency == 100.0
    assert factory.pin(18).state == 1.0
    clock.advance_s(0.0799)
    motor.tick(clock.now_s())
    assert factory.pin(18).state == 1.0
    clock.advance_s(0.0002)
    motor.tick(clock.now_s())
    assert factory.pin(18).state == 0.7
    assert states(factory) == [0.0, 1.0, 0.7]


def test_a_motor_that_turns_is_not_kicked_again(
    context: DriverContext, factory: MockFactory, clock: ManualClock
) -> None:
    motor = make(context)
    motor.apply(command(0.5))
    clock.advance_s(0.1)
    motor.apply(command(0.25))
    motor.apply(command(1e-6))
    assert states(factory) == [0.0, 1.0, 0.54, 0.4]


def test_a_level_that_changes_during_the_kick_counts_when_the_kick_is_over(
    context: DriverContext, factory: MockFactory, clock: ManualClock
) -> None:
    motor = make(context)
    motor.apply(command(0.5))
    clock.advance_s(0.04)
    motor.apply(command(0.25))
    assert factory.pin(18).state == 1.0
    clock.advance_s(0.05)
    motor.tick(clock.now_s())
    assert states(factory) == [0.0, 1.0, 0.54]


def test_level_zero_in_the_middle_of_a_kick_stands_still_and_the_next_start_is_kicked(
    context: DriverContext, factory: MockFactory, clock: ManualClock
) -> None:
    motor = make(context)
    motor.apply(command(0.5))
    clock.advance_s(0.04)
    assert motor.apply(command(0.0)).level == 0.0
    clock.advance_s(0.02)
    motor.tick(clock.now_s())
    assert factory.pin(18).state == 0.0
    motor.apply(command(0.5))
    clock.advance_s(0.07)
    motor.tick(clock.now_s())
    assert states(factory) == [0.0, 1.0, 0.0, 1.0]


def test_the_frequency_is_the_configured_one(context: DriverContext, factory: MockFactory) -> None:
    motor = make(context, frequency="2 kHz")
    assert factory.pin(18).frequency == 2000.0
    motor.close()
    assert factory.pin(18).frequency is None


@each_case(
    "wrong",
    [
        {"frequency": "20 kHz"},
        {"frequency": "0 Hz"},
        {"frequency": "19 Hz"},  # it would stop late
        {"minimum_duty": 0.0},
        {"minimum_duty": 1.01},
        {"kick": "1 min"},
        {"pin": 28},
        {"pin": "18"},
        {"power": 1},
    ],
)
def test_options_that_no_motor_could_follow_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        VibrationMotorOptions.model_validate({"pin": 18, **wrong})
