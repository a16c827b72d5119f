"""A configuration that is right, to which each test adds what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError, Problem

SOUND = """\
[camera]
driver = "opencv"
device = 0
[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0
fy_px = 600.0
cx_px = 319.5
cy_px = 239.5
[targets.ball]
detector = "ball"
diameter = "6.4 cm"
hsv = "29,86,6:64,255,255"
[actuators.motor]
driver = "vibration-motor"
pin = 18
[actuators.buzzer]
driver = "buzzer"
pin = 23
[base]
driver = "ros-arduino-bridge"
auto_stop = "500 ms"
port = "/dev/ttyUSB0"
wheel_diameter = "6.5 cm"
ticks_per_turn = 1440
track_width = "20 cm"
"""

Load = Callable[[str], Configuration]
Problems = Callable[[str], tuple[Problem, ...]]


@pytest.fixture
def sound() -> str:
    """Return a configuration without errors and without rules."""
    return SOUND


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Return a function that loads a text as if it stood in a file."""

    def load_text(text: str) -> Configuration:
        file = tmp_path / "test.toml"
        file.write_text(text, encoding="utf-8")
        return load_configuration(file)

    return load_text


@pytest.fixture
def problems_of(load: Load) -> Problems:
    """Return a function that loads a text that is wrong and returns what is."""

    def problems(text: str) -> tuple[Problem, ...]:
        with pytest.raises(ConfigError) as caught:
            load(text)
        return caught.value.problems

    return problems


@pytest.fixture
def told(problems_of: Problems) -> Callable[[str], list[str]]:
    """Return a function that loads a text that is wrong and returns ``key: message (hint)`` of each problem."""

    def told_of(text: str) -> list[str]:
        return [str(problem).split(": ", 1)[1] for problem in problems_of(text)]

    return told_of
