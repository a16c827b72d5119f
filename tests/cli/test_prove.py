"""The command ``prove`` says what it covered and found, and leaves a counter-example that ``replay`` opens."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.app import leased_output
from stadimeter.cli.main import app

FOLLOW_BALL = (Path(__file__).parents[2] / "config" / "follow-ball.toml").read_text(encoding="utf-8")

Proved = Callable[..., Result]


@pytest.fixture
def proved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Proved:
    """Return a function that runs the command in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    text = FOLLOW_BALL.replace('driver = "gpio-motors"', 'driver = "ros-arduino-bridge"')
    Path("robot.toml").write_text(text, encoding="utf-8")
    return lambda *options: CliRunner().invoke(app, ["prove", "robot.toml", *options])


def test_what_holds_is_said_with_what_it_covers(proved: Proved, tmp_path: Path) -> None:
    result = proved("--faults", "1", "--only", "block-camera", "--only", "end-process")
    assert result.exit_code == 0, result.output
    words = " ".join(result.stdout.split())
    assert "3 of 3 sequences" in words
    assert "Faults: block-camera, end-process." in words
    assert "not a certificate" in words
    assert "No single fault keeps the wheels turning longer than 0." in words
    assert not (tmp_path / "counter-example.jsonl").exists()


def test_a_counter_example_is_a_journal_that_replay_opens(
    proved: Proved, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leased_output, "REST_S", 0.0)
    result = proved("--faults", "1", "--only", "unplug-base")
    assert result.exit_code == 1, result.output
    words = " ".join(result.stdout.split())
    assert "Counter-example: unplug-base at 1.50 s" in words
    assert "before it has rested for 3 s" in words
    assert "stadimeter replay counter-example.jsonl" in words
    replayed = CliRunner().invoke(app, ["replay", str(tmp_path / "counter-example.jsonl")])
    assert replayed.exit_code == 0, replayed.output
    assert "fault" in replayed.stdout


def test_a_fault_that_there_is_not_is_refused(proved: Proved) -> None:
    result = proved("--only", "earthquake")
    assert result.exit_code == 2
    assert "cannot suffer earthquake; it can: block-camera" in result.stderr
