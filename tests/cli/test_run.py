"""The commands run, demo and replay, as a user types them."""

import json
from pathlib import Path

import pytest

from support.command_line import typed
from support.simulated_run import SIMULATED_BALL

CONFIG = Path(__file__).resolve().parents[2] / "config"

SIMULATED = (
    SIMULATED_BALL
    + """
[rules.far]
actuator = "motor"
ramp = { from = "0.5 m", to = "1 m" }
[world]
"""
)


@pytest.fixture
def simulated(tmp_path):
    path = tmp_path / "simulated.toml"
    path.write_text(SIMULATED)
    return path


def test_a_run_prints_lines_and_a_summary_and_ends_with_0(simulated):
    done = typed("run", simulated, "--seconds", 3, "--speed", 0)
    assert done.returncode == 0, done.stderr
    assert "ball target seen" in done.stdout
    assert "motor 100 %" in done.stdout
    assert done.stdout.splitlines()[-4].startswith("Ended: 3 s, as asked for. 90 frames in 90 cycles.")
    assert done.stderr == ""


def test_a_ball_whose_colour_is_nowhere_is_said_at_the_end_with_what_to_try(tmp_path):
    world = SIMULATED.replace(
        'detector = "ideal"', 'detector = "ball"\ndiameter = "20 cm"\nhsv = "110,200,60:130,255,255"'
    )
    path = tmp_path / "blue.toml"
    path.write_text(world.replace("render = false\n", ""))
    done = typed("run", path, "--frames", 5, "--speed", 0, "--no-state")
    assert f"ball was never seen. `stadimeter colour --live {path}`" in done.stdout


def test_json_prints_one_object_and_nothing_else(simulated):
    done = typed("run", simulated, "--frames", 30, "--speed", 0, "--json")
    figures = json.loads(done.stdout)
    assert figures["frames"] == 30
    assert figures["ended"] == "30 frames, as asked for"
    assert figures["tracks"]["ball"]["tracking"] >= 28


@pytest.mark.long
def test_the_demo_shows_rules_acting_without_hardware():
    done = typed("demo", "--plain", "--seconds", 10, "--speed", 0)
    assert done.returncode == 0, done.stderr
    assert "ACTIVE follow" in done.stdout
    assert "ACTIVE far" in done.stdout
    assert done.stderr == ""


@pytest.mark.long
def test_without_a_terminal_the_demo_and_a_watched_run_print_lines(simulated):
    for command in (["demo"], ["run", simulated, "--watch"]):
        done = typed(*command, "--seconds", 2, "--speed", 0)
        assert done.returncode == 0, done.stderr
        assert "\x1b" not in done.stdout
        assert "1.0 s  ball" in done.stdout


def test_the_demo_ends_with_what_to_do_next():
    done = typed("demo", "--seconds", 0.1, "--speed", 0)
    commands = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("  stadimeter ")]
    assert commands == ["init", "calibrate", "check"]
    assert max(map(len, done.stdout.splitlines()[-4:])) < 80


@pytest.mark.parametrize("name", ["follow-ball", "appliance"])
def test_a_configuration_for_real_hardware_says_plainly_that_there_is_none(name):
    done = typed("run", CONFIG / f"{name}.toml", "--seconds", 1)
    assert done.returncode == 2
    assert "error: camera: " in done.stderr
    assert "Traceback" not in done.stderr


def test_a_configuration_that_is_missing_or_a_directory_is_one_clear_line_and_2(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        done = typed("run", path)
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1
        assert str(path) in done.stderr


def test_a_full_disk_under_the_journal_is_told_at_once_and_at_the_end_and_ends_no_run(simulated):
    done = typed("run", simulated, "--seconds", 5, "--speed", 0, "--journal", "/dev/full")
    assert done.returncode == 0
    why = "/dev/full: No space left on device; the journal ends here, intact"
    assert done.stderr.splitlines() == [
        f"warning: {why}; the run goes on without it",
        f"warning: the journal is not whole: {why}",
    ]
    assert f"journal: {why}" in done.stdout
    assert "150 frames" in done.stdout


def test_bad_usage_ends_with_2():
    assert typed("run").returncode == 2
    assert typed("run", "x.toml", "--frames", 0).returncode == 2
    assert typed("fly").returncode == 2
