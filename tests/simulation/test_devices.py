from __future__ import annotations

import pytest

from stadimeter.config.plugins import ACTUATORS
from stadimeter.core.command import LevelCommand
from stadimeter.simulation.devices import LevelChange


def command(level: float) -> LevelCommand:
    return LevelCommand(output="it", level=level, captured_at_s=1.0)


def test_it_remembers_what_it_did_when(run) -> None:
    actuator = run.build(ACTUATORS)
    actuator.open()
    for level in (0.0, 0.4, 0.4, 1.0):
        run.clock.advance_s(1.0)
        actuator.apply(command(level))
    actuator.stop()
    assert list(actuator.changes) == [
        LevelChange(at_s=102.0, level=0.4),
        LevelChange(at_s=104.0, level=1.0),
        LevelChange(at_s=104.0, level=0.0),
    ]


def test_its_memory_is_bounded(run) -> None:
    actuator = run.build(ACTUATORS, history=3)
    actuator.open()
    for number in range(10):
        actuator.apply(command(number / 10))
    assert [change.level for change in actuator.changes] == [0.7, 0.8, 0.9]


@pytest.mark.parametrize(("steps", "asked", "done"), [(1, 0.4, 0.0), (1, 0.6, 1.0), (4, 0.3, 0.25), (None, 0.3, 0.3)])
def test_a_level_is_rounded_to_the_steps_that_it_can_do(run, steps: int | None, asked: float, done: float) -> None:
    actuator = run.build(ACTUATORS, steps=steps)
    actuator.open()
    assert actuator.apply(command(asked)).level == done
    assert actuator.level == done
