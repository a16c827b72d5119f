"""Whole runs in a simulated world, as fast as the computer can."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec import Struct, field

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
from support.simulated_run import SIMULATED_BALL

EMULATED_BASE = """driver = "ros-arduino-bridge"
port = "emulated-ros-arduino-bridge"
wheel_diameter = "6.5 cm"
ticks_per_turn = 800
track_width = "20 cm"
"""
WORLD = (
    SIMULATED_BALL
    + """
[actuators.buzzer]
driver = "simulated"

[base]
"""
    + EMULATED_BASE
    + """
[messenger]
driver = "simulated"

[rules.far]
actuator = "motor"
ramp = { from = "1.5 m", to = "3 m" }

[rules.near]
actuator = "buzzer"
when = { below = "50 cm" }

[rules.follow]
actuator = "base"
follow = { distance = "1 m", max_speed = "0.4 m/s" }

[world]
camera_height = "12 cm"
ticks_per_metre = 3917.7
"""
)


class Scenario(Struct):
    """A run whose world can be looked at and changed on the way.

    Attributes:
        loop: The run.
        records: Every cycle so far.
        script: What to do at which times: functions that are called once.
    """

    loop: Loop
    records: list[CycleRecord] = field(default_factory=list)
    script: list[tuple[float, Callable[[], Any]]] = field(default_factory=list)

    @property
    def world(self) -> Any:
        return self.loop.parts.shared.parts["world"]

    def at(self, time_s: float, act: Callable[[], Any]) -> None:
        self.script.append((time_s, act))
        self.script.sort(key=lambda entry: entry[0])

    def run(self, seconds: float) -> Scenario:
        self.loop.listeners.append(self._listen)
        self.loop.run(Limits(seconds=seconds))
        return self

    def _listen(self, record: CycleRecord, _frame: object) -> None:
        self.records.append(record)
        while self.script and self.script[0][0] <= record.observation.now_s:
            self.script.pop(0)[1]()

    def base_speeds(self, from_s: float, to_s: float) -> list[float]:
        """Return what the base was really told, at each cycle."""
        return [
            command.linear_mps
            for record in self.records
            if from_s <= record.observation.now_s < to_s
            for command in record.applied
            if command.output == "base"
        ]

    def events(self) -> list[tuple[str, str]]:
        return [(event.source, event.kind.value) for record in self.records for event in record.decision.events]


@pytest.fixture
def scenario(tmp_path: Path) -> Callable[..., Scenario]:
    """Return a function that makes a scenario from the world above and changes to it."""

    def make(world: str = "", text: str = WORLD, base: str = "", *, is_base_emulated: bool = True) -> Scenario:
        path = tmp_path / "scenario.toml"
        if not is_base_emulated:
            text = text.replace(EMULATED_BASE, 'driver = "simulated"\n')
        path.write_text(text.replace("[base]", f"[base]\n{base}") + world)
        return Scenario(Loop(build(load_configuration(path), speed=None)))

    return make
