"""The command `outputs safe`, against a real pseudo-terminal."""

from __future__ import annotations

import json
import os
import select
from pathlib import Path

import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from support.simulated_run import SIMULATED_BALL

BASE = """
[base]
driver = "ros-arduino-bridge"
port = "{port}"
wheel_diameter = "6.5 cm"
ticks_per_turn = 800
track_width = "20 cm"
[world]
"""


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "robot.toml"


def test_a_base_is_stopped_by_hand(config: Path) -> None:
    ours, theirs = os.openpty()
    config.write_text(SIMULATED_BALL + BASE.format(port=os.ttyname(theirs)))
    found = CliRunner().invoke(app, ["outputs", "safe", str(config)])
    assert (found.exit_code, found.output) == (0, f"safe: serial {os.ttyname(theirs)} 57600 0d6d203020300d\n")
    assert select.select([ours], [], [], 60)[0]
    assert os.read(ours, 100) == b"\rm 0 0\r"
    os.close(ours)
    os.close(theirs)


def test_what_could_not_be_made_safe_is_an_error(config: Path) -> None:
    config.write_text(SIMULATED_BALL + BASE.format(port="/dev/ttyNone"))
    found = CliRunner().invoke(app, ["outputs", "safe", str(config)])
    assert found.exit_code == 2
    assert "serial /dev/ttyNone: there is no such port" in found.output


def test_what_is_simulated_needs_nothing(config: Path) -> None:
    config.write_text(SIMULATED_BALL + BASE.format(port="emulated-ros-arduino-bridge"))
    found = CliRunner().invoke(app, ["outputs", "safe", str(config)])
    assert (found.exit_code, found.output) == (0, "nothing to do: every output is simulated\n")
    found = CliRunner().invoke(app, ["outputs", "safe", str(config), "--json"])
    assert json.loads(found.output)["safe"] == []


def test_while_a_run_drives_the_outputs_it_is_refused(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config.write_text(SIMULATED_BALL + BASE.format(port="/dev/ttyNone"))
    monkeypatch.setattr("stadimeter.cli.operate.find", lambda _path: Path("/run/robot.sock"))
    found = CliRunner().invoke(app, ["outputs", "safe", str(config)])
    assert found.exit_code == 2
    assert "a run drives these outputs" in found.output
    assert "/dev/ttyNone" not in found.output
