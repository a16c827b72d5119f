from __future__ import annotations

import pytest
from gpiozero.pins.mock import MockFactory, MockPin
from pydantic import ValidationError

from stadimeter.actuators.pin_actuator import BuzzerOptions, GpiozeroBuzzer
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import LevelCommand
from stadimeter.gpio.output_pin import SHARED_KEY
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


def test_a_low_level_beeps_once_a_second(context: DriverContext, factory: MockFactory, clock: ManualClock) -> None:
    buzzer = make(context)
    assert buzzer.apply(command(1e-9)) == command(1e-9)
    assert factory.pin(23).state == 1.0
    assert edges_s(buzzer, factory, clock, 2.5) == [0.06, 1.0, 1.06, 2.0, 2.06]


def test_a_higher_level_beeps_faster(context: DriverContext, factory: MockFactory, clock: ManualClock) -> None:
    buzzer = make(context, slowest="800 ms", fastest="200 ms", beep="100 ms")
    buzzer.apply(command(0.5))
    assert edges_s(buzzer, factory, clock, 1.0) == [0.1, 0.4, 0.5, 0.8, 0.9]


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


def test_a_buzzer_needs_no_pulses(clock: ManualClock) -> None:
    context = DriverContext(name="buzzer", clock=clock)
    factory = context.share(SHARED_KEY, lambda: MockFactory(pin_class=MockPin))
    buzzer = make(context)
    buzzer.apply(command(1.0))
    assert factory.pin(23).state is True


@each_case(
    "wrong",
    [
        {"beep": "10 ms"},
        {"beep": "90 ms"},
        {"fastest": "2 s"},
        {"slowest": "2 min"},
        {"slowest": 1.0},
        {"pin": True},
    ],
)
def test_beeps_that_could_not_be_told_apart_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        BuzzerOptions.model_validate({"pin": 23, **wrong})
