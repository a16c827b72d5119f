"""Buzzers, vibration motors and switches, and what they make of patterns of levels."""

from __future__ import annotations

from itertools import groupby

import pytest
from gpiozero.pins.mock import MockFactory
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from stadimeter.actuators.pin_actuator import (
    BeepPattern,
    BuzzerOptions,
    DutySteps,
    GpiozeroBuzzer,
    GpiozeroSwitch,
    GpiozeroVibrationMotor,
    LedOptions,
    RelayOptions,
    VibrationMotorOptions,
)
from stadimeter.actuators.protocol import Actuator
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import LevelCommand
from stadimeter.core.rule import Pattern
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case


def make(context: DriverContext, **options: object) -> GpiozeroBuzzer:
    buzzer = GpiozeroBuzzer(BuzzerOptions.model_validate({"pin": 23, **options}), context)
    buzzer.open()
    return buzzer


def command(level: float) -> LevelCommand:
    return LevelCommand(output="buzzer", level=level, captured_at_s=0.0)


def edges_s(buzzer: GpiozeroBuzzer, factory: MockFactory, clock: ManualClock, seconds: float) -> list[float]:
    """Tick every 20 ms and return when the pin changed."""
    edges, before = [], factory.pin(23).state
    for _ in range(round(seconds / 0.02)):
        clock.advance_s(0.02)
        buzzer.tick(clock.now_s())
        if factory.pin(23).state != before:
            before = factory.pin(23).state
            edges.append(round(clock.now_s(), 2))
    return edges


def test_a_steady_buzzer_sounds_at_any_level_above_zero(
    context: DriverContext, factory: MockFactory, clock: ManualClock
) -> None:
    buzzer = make(context, steady=True)
    assert buzzer.apply(command(0.01)) == command(1.0)
    assert edges_s(buzzer, factory, clock, 2.0) == []
    assert factory.pin(23).state == 1.0
    assert buzzer.apply(command(0.0)) == command(0.0)
    assert factory.pin(23).state == 0.0


def test_a_stop_in_the_middle_of_a_beep_is_forgotten_by_the_next_command(
    context: DriverContext, factory: MockFactory, clock: ManualClock
) -> None:
    buzzer = make(context)
    buzzer.apply(command(0.2))
    clock.advance_s(0.02)
    buzzer.stop()
    assert factory.pin(23).state == 0.0
    clock.advance_s(0.02)
    buzzer.apply(command(0.2))
    assert factory.pin(23).state == 1.0, "a beep that was cut off does not count"


@each_case("wrong", [{"pin": True}])
def test_beeps_that_could_not_be_told_apart_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        BuzzerOptions.model_validate({"pin": 23, **wrong})


TICK_S = 0.02


def make_pattern() -> BeepPattern:
    return BeepPattern()


def beeps(sounding: list[bool]) -> int:
    return sum(now and not before for before, now in zip([False, *sounding], sounding, strict=False))


def listen(pattern: BeepPattern, levels: list[float], tick_s: float = TICK_S) -> list[bool]:
    return [pattern.sounds(level, index * tick_s) for index, level in enumerate(levels)]


@pytest.mark.parametrize(("level", "expected"), [(1e-9, 10), (0.5, 32), (1 - 1e-9, 100)])
def test_the_rate_goes_from_the_slowest_to_the_fastest_in_equal_ratios(level: float, expected: int) -> None:
    sounding = listen(make_pattern(), [level] * 500)  # for 10 s; 32 is 10 s over 1 s times the square root of a tenth
    assert beeps(sounding) == pytest.approx(expected, abs=1)


def test_beeps_come_at_their_times_to_the_tick() -> None:
    pattern = make_pattern()
    at_ms = [ms for ms in range(3000) if pattern.sounds(1e-12, ms / 1000)]
    assert at_ms == [*range(50), *range(1000, 1050), *range(2000, 2050)]


def test_a_beep_that_fell_into_a_long_gap_between_ticks_is_made_up_for() -> None:
    pattern = make_pattern()
    assert pattern.sounds(0.5, 0.0)
    assert pattern.sounds(0.5, 0.9)
    assert pattern.sounds(0.5, 0.94)
    assert not pattern.sounds(0.5, 0.96)


def test_a_level_that_changes_all_the_time_neither_cuts_a_beep_short_nor_starves_the_next() -> None:
    levels = [0.3 + 0.4 * (index % 2) for index in range(500)]
    sounding = listen(make_pattern(), levels)
    assert 10 / 0.5012 - 1 <= beeps(sounding) <= 10 / 0.1995 + 1  # the periods at 0.3 and 0.7
    runs = "".join("#" if sound else "." for sound in sounding).strip(".").replace(".", " ").split()
    assert {len(run) for run in runs[:-1]} <= {2, 3}  # a beep of 50 ms is on for two or three ticks


@pytest.mark.long
@given(levels=st.lists(st.floats(0.01, 1.0), min_size=60, max_size=200))
def test_whatever_the_level_does_above_zero_it_sounds_at_least_once_in_the_slowest_period(levels: list[float]) -> None:
    sounding = listen(make_pattern(), levels)
    window = round(1.0 / TICK_S) + 1
    assert all(any(sounding[start : start + window]) for start in range(len(sounding) - window + 1))


# What the real drivers make of a pattern of levels, commanded at 30 frames a second and ticked every 20 ms.

PIN = 18
BEEPS = Pattern(steps=((1.0, 0.2), (0.0, 0.3)), times=3)
FLICKER = Pattern(steps=((1.0, 0.1), (0.0, 0.1)))
STEP_S = 0.001
FRAME_STEPS, TICK_STEPS = 33, 20


def played(
    driver: Actuator, pattern: Pattern, clock: ManualClock, factory: MockFactory, seconds: float
) -> list[tuple[float, float]]:
    """Play a pattern and return what the pin had, and for how long each time in seconds."""
    states: list[float] = []
    for step in range(round(seconds / STEP_S)):
        if step % FRAME_STEPS == 0:
            driver.apply(LevelCommand(output="it", level=pattern.level(step * STEP_S), captured_at_s=clock.now_s()))
        elif step % TICK_STEPS == 0:
            driver.tick(clock.now_s())
        states.append(factory.pin(PIN).state)
        clock.advance_s(STEP_S)
    return [(state, len(list(group)) * STEP_S) for state, group in groupby(states)]


DRIVERS = {
    "lamp": LedOptions(pin=PIN),
    "relay": RelayOptions(pin=PIN, active_high=True),
    "buzzer": BuzzerOptions(pin=PIN),
    "motor": VibrationMotorOptions(pin=PIN),
}


@pytest.mark.parametrize("name", DRIVERS)
@pytest.mark.parametrize(
    ("pattern", "seconds", "steps_s"), [(BEEPS, 3.0, [0.2, 0.3] * 3), (FLICKER, 2.0, [0.1, 0.1] * 10)]
)
def test_every_step_of_a_pattern_comes_through_to_within_a_frame(
    name: str, pattern: Pattern, seconds: float, steps_s: list[float], context: DriverContext, factory: MockFactory
) -> None:
    driver = DRIVERS[name].build(context)
    driver.open()
    found = played(driver, pattern, context.clock, factory, seconds)
    assert [state for state, _ in found] == [1.0, 0.0] * (len(steps_s) // 2)
    for (_, lasted_s), expected_s in zip(found[:-1], steps_s, strict=False):
        assert lasted_s == pytest.approx(expected_s, abs=FRAME_STEPS * STEP_S)


def test_each_burst_of_a_buzzer_at_half_level_begins_with_a_beep_at_once(
    context: DriverContext, clock: ManualClock, factory: MockFactory
) -> None:
    buzzer = DRIVERS["buzzer"].build(context)
    buzzer.open()
    found = played(buzzer, Pattern(steps=((0.5, 0.2), (0.0, 0.8))), clock, factory, seconds=3.0)
    assert [state for state, _ in found] == [1.0, 0.0] * 3
    assert found[0][1] == pytest.approx(0.05, abs=0.02)


def test_each_burst_of_a_motor_begins_with_its_kick_and_goes_on_as_told(
    context: DriverContext, clock: ManualClock, factory: MockFactory
) -> None:
    motor = DRIVERS["motor"].build(context)
    motor.open()
    found = played(motor, Pattern(steps=((0.5, 0.4), (0.0, 0.4))), clock, factory, seconds=1.5)
    assert [state for state, _ in found] == [1.0, 0.7, 0.0, 1.0, 0.7, 0.0][: len(found)]
    assert found[0][1] == pytest.approx(0.08, abs=0.021)
    assert len(found) >= 5


def make_motor(context: DriverContext, **options: object) -> GpiozeroVibrationMotor:
    motor = GpiozeroVibrationMotor(VibrationMotorOptions.model_validate({"pin": 18, **options}), context)
    motor.open()
    return motor


def motor_command(level: float) -> LevelCommand:
    return LevelCommand(output="motor", level=level, captured_at_s=0.0)


def states(factory: MockFactory) -> list[float]:
    return [state for _, state in factory.pin(18).states]


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
    motor = make_motor(context)
    assert motor.apply(motor_command(0.5)).level == pytest.approx(0.5, abs=0.01)
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
    motor = make_motor(context)
    motor.apply(motor_command(0.5))
    clock.advance_s(0.1)
    motor.apply(motor_command(0.25))
    motor.apply(motor_command(1e-6))
    assert states(factory) == [0.0, 1.0, 0.54, 0.4]


def test_a_level_that_changes_during_the_kick_counts_when_the_kick_is_over(
    context: DriverContext, factory: MockFactory, clock: ManualClock
) -> None:
    motor = make_motor(context)
    motor.apply(motor_command(0.5))
    clock.advance_s(0.04)
    motor.apply(motor_command(0.25))
    assert factory.pin(18).state == 1.0
    clock.advance_s(0.05)
    motor.tick(clock.now_s())
    assert states(factory) == [0.0, 1.0, 0.54]


def test_level_zero_in_the_middle_of_a_kick_stands_still_and_the_next_start_is_kicked(
    context: DriverContext, factory: MockFactory, clock: ManualClock
) -> None:
    motor = make_motor(context)
    motor.apply(motor_command(0.5))
    clock.advance_s(0.04)
    assert motor.apply(motor_command(0.0)).level == 0.0
    clock.advance_s(0.02)
    motor.tick(clock.now_s())
    assert factory.pin(18).state == 0.0
    motor.apply(motor_command(0.5))
    clock.advance_s(0.07)
    motor.tick(clock.now_s())
    assert states(factory) == [0.0, 1.0, 0.0, 1.0]


@each_case(
    "wrong",
    [
        {"frequency": "20 kHz"},
        {"frequency": "0 Hz"},
        {"frequency": "19 Hz"},  # it would stop late
        {"minimum_duty": 0.0},
        {"minimum_duty": 1.01},
        {"kick": "80 ms"},
        {"pin": 28},
        {"pin": "18"},
        {"power": 1},
    ],
)
def test_options_that_no_motor_could_follow_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        VibrationMotorOptions.model_validate({"pin": 18, **wrong})


def led(context: DriverContext, **options: object) -> GpiozeroSwitch:
    lamp = LedOptions.model_validate({"pin": 24, **options}).build(context)
    lamp.open()
    return lamp


def relay(context: DriverContext, **options: object) -> GpiozeroSwitch:
    switch = RelayOptions.model_validate({"pin": 24, **options}).build(context)
    switch.open()
    return switch


def switch_command(level: float) -> LevelCommand:
    return LevelCommand(output="it", level=level, captured_at_s=0.0)


@pytest.mark.parametrize(("level", "applied"), [(0.0, 0.0), (0.499, 0.0), (0.5, 1.0), (1.0, 1.0)])
def test_a_lamp_is_on_from_half_the_level(
    context: DriverContext, factory: MockFactory, level: float, applied: float
) -> None:
    lamp = led(context)
    assert lamp.apply(switch_command(level)) == switch_command(applied)
    assert factory.pin(24).state == applied
    assert factory.pin(24).frequency is None


@pytest.mark.parametrize(("level", "applied"), [(0.0, 0.0), (0.004, 0.0), (0.005, 0.01), (0.29, 0.29), (0.996, 1.0)])
def test_a_dimmed_lamp_is_as_bright_as_the_nearest_percent(
    context: DriverContext, factory: MockFactory, level: float, applied: float
) -> None:
    lamp = led(context, dimmed=True, frequency="200 Hz")
    assert lamp.apply(switch_command(level)).level == applied
    assert factory.pin(24).state == pytest.approx(applied)
    assert factory.pin(24).frequency == 200.0


def test_a_relay_is_switched_by_a_low_pin_unless_told_otherwise(context: DriverContext, factory: MockFactory) -> None:
    switch = relay(context)
    assert factory.pin(24).state == 1.0
    switch.apply(switch_command(1.0))
    assert factory.pin(24).state == 0.0
    switch.stop()
    assert factory.pin(24).state == 1.0
    switch.close()
    other = relay(context, active_high=True)
    other.apply(switch_command(1.0))
    assert factory.pin(24).state == 1.0


@pytest.mark.parametrize(
    "wrong", [{"on_at": 0.5}, {"dimmed": True, "frequency": "1 Hz"}, {"frequency": "200 Hz"}], ids=str
)
def test_options_that_would_have_no_effect_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        LedOptions.model_validate({"pin": 24, **wrong})
