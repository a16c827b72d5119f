"""What the real drivers make of a pattern of levels, commanded at 30 frames a second and ticked every 20 ms."""

from __future__ import annotations

from itertools import groupby

import pytest
from gpiozero.pins.mock import MockFactory

from stadimeter.actuators.pin_actuator import BuzzerOptions, LedOptions, RelayOptions, VibrationMotorOptions
from stadimeter.actuators.protocol import Actuator
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import LevelCommand
from stadimeter.core.rule import Pattern
from stadimeter.testing.rig import ManualClock

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
