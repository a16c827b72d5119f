"""The command replay, and what run leaves behind for it, as a user types them."""

import json
import shutil
import socket
from pathlib import Path

import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.config.plugins import ACTUATORS, BASES, CAMERAS, MESSENGERS, PORTS, WORLDS, driver_names, load_driver

OPENED = (CAMERAS, ACTUATORS, BASES, MESSENGERS, PORTS, WORLDS)

DRAWN = """
[camera]
driver = "simulated"
rate = "15 Hz"
model = "lens.toml"

[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[actuators.motor]
driver = "simulated"

[rules.near]
actuator = "motor"
when = { below = "120 cm" }

[world]
loop = false
path = [ { at = "0 s", x = "2 m", y = "0 m" }, { at = "3 s", x = "0.8 m", y = "0 m" } ]
"""

LENS = """
width_px = 320
height_px = 240
fx_px = 300.0
"""


def stadimeter(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture
def drawn(tmp_path):
    folder = tmp_path / "configurations"
    folder.mkdir()
    (folder / "lens.toml").write_text(LENS)
    path = folder / "drawn.toml"
    path.write_text(DRAWN)
    return path


@pytest.fixture(scope="module")
def run_once(tmp_path_factory):
    """A run with a journal and a recording of it."""
    folder = tmp_path_factory.mktemp("once")
    (folder / "lens.toml").write_text(LENS)
    (folder / "drawn.toml").write_text(DRAWN)
    paths = folder / "run.jsonl", folder / "run.mcap"
    words = ["--seconds", 3, "--speed", 0, "--journal", paths[0], "--record", paths[1]]
    done = stadimeter("run", folder / "drawn.toml", *words)
    assert done.exit_code == 0, done.output
    return paths


@pytest.fixture
def recorded(run_once, tmp_path):
    """Copies of the journal and the recording of one run."""
    return tuple(Path(shutil.copy(path, tmp_path)) for path in run_once)


def moved(drawn):
    """Let nothing of the configuration be found where it was."""
    drawn.rename(drawn.with_name("another.toml"))
    (drawn.parent / "lens.toml").unlink()


def test_a_recording_replays_with_its_own_configuration_though_the_files_are_gone(recorded, drawn):
    moved(drawn)
    for path in recorded:
        done = stadimeter("replay", path, "--strict", "--json")
        assert done.exit_code == 0, done.output
        result = json.loads(done.stdout)
        assert result["same_configuration"]
        assert result["identical"] == result["cycles"] > 0
        assert "raised" in [event["kind"] for event in result["events"]]


def test_other_rules_are_compared_with_old_ones_for_programs(recorded, drawn):
    new = drawn.with_name("new.toml")
    new.write_text(DRAWN.replace("120 cm", "10 cm"))
    done = stadimeter("replay", recorded[1], "--config", new, "--diff", drawn, "--json")
    diff = json.loads(done.stdout)["diff"]
    assert [change["change"] for change in diff["changes"]] == ["lost"]
    (rule,) = diff["rules"]
    assert (rule["old"]["raised"], rule["new"]["raised"]) == (1, 0)


def test_a_recording_is_measured_again_with_other_settings(recorded, drawn):
    new = drawn.with_name("new.toml")
    new.write_text(DRAWN.replace("20 cm", "10 cm"))  # half the ball at half the distance
    done = stadimeter("replay", recorded[1], "--config", new, "--from-images", "--json")
    assert done.exit_code == 0, done.output
    (again,) = json.loads(done.stdout)["measured_again"]
    assert again["found_before"] == again["found_again"] == again["frames"] == 45
    assert again["differs_most_m"] == pytest.approx(1.0, rel=0.03), "at 2 m, where the run began"


def test_a_journal_has_no_pictures_and_says_where_to_get_some(recorded):
    done = stadimeter("replay", recorded[0], "--from-images")
    assert done.exit_code == 2
    assert "is a journal, and has no pictures to measure in; record one with" in done.stderr


def test_frames_without_pictures_count_as_missing_and_are_told(drawn, tmp_path):
    path = tmp_path / "run.mcap"
    stadimeter("run", drawn, "--seconds", 1, "--speed", 0, "--record", path, "--image-rate", 5)
    done = stadimeter("replay", path, "--from-images")
    assert done.exit_code == 0
    assert "only 5 of 15 frames are recorded with their pictures; the others count as missing" in done.stderr


@pytest.mark.parametrize("index", [0, 1])
def test_a_recording_that_was_cut_off_is_used_as_far_as_it_goes_and_said_so(recorded, index):
    path = recorded[index]
    path.write_bytes(path.read_bytes()[: -path.stat().st_size // 4])
    done = stadimeter("replay", path, "--strict")
    assert done.exit_code == 0, done.output
    assert "whole cycles are used" in done.stderr
    assert "0 whole" not in done.stderr


def test_a_configuration_inside_a_recording_that_cannot_be_used_is_told_with_the_recordings_name(recorded):
    path = recorded[0]
    path.write_text(path.read_text().replace("120 cm", "120 yards"))
    done = stadimeter("replay", path)
    assert done.exit_code == 2
    assert f"error: {path} (its configuration):" in done.stderr
    assert "Traceback" not in done.output


@pytest.mark.parametrize("words", [[], ["--from-images"], ["--diff", "old"]])
def test_a_replay_opens_no_socket_and_builds_no_camera_and_no_output(recorded, drawn, monkeypatch, words):
    def never(*_, **__):
        raise AssertionError("a replay opened something")

    for driver in {load_driver(group, name) for group in OPENED for name in driver_names(group)}:
        monkeypatch.setattr(driver, "build", never)
    monkeypatch.setattr(socket, "socket", never)
    monkeypatch.setattr(socket, "create_connection", never)
    words = [drawn if word == "old" else word for word in words]
    done = stadimeter("replay", recorded[1], *words)
    assert done.exit_code == 0, done.output


def test_journal_and_recording_need_a_file_each(drawn, tmp_path):
    path = tmp_path / "run"
    done = stadimeter("run", drawn, "--seconds", 1, "--speed", 0, "--record", path, "--journal", path)
    assert done.exit_code == 2
    assert "they need a file each" in done.stderr
    assert not path.exists()


def test_a_recording_without_a_whole_cycle_is_one_clear_line_and_2(tmp_path, recorded):
    empty = tmp_path / "empty.jsonl"
    empty.write_bytes(recorded[0].read_bytes().splitlines(keepends=True)[0])
    done = stadimeter("replay", empty)
    assert done.exit_code == 2
    assert "holds no whole cycle, so there is nothing to replay" in done.stderr
