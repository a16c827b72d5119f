"""What a run keeps of its last hour by itself."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.control.recording import LastRecording, delete_old, last_folder
from stadimeter.app.control.reloading import needs_restart
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.watching import attend_to_requests
from stadimeter.config.loader import load_configuration
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError
from stadimeter.testing.rig import eventually
from stadimeter.workbench.replay import read_recording, replay_run
from support.simulated_run import SIMULATED_BALL

# Few cycles in a simulated minute, so that a slow disk keeps up.
OWN = f"""{SIMULATED_BALL.replace('rate = "30 Hz"', 'rate = "5 Hz"')}
[recording]
last = "1 min"
[rules.near]
actuator = "motor"
when = {{ below = "1 m" }}
on_delay = "0 s"
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
loop = false
"""


def run_room(folder: Path, frames: int) -> tuple[Path, list[str]]:
    """Run it; simulated time waits for the threads that open files. Return its file, and what was said."""
    path, told = folder / "room.toml", list[str]()
    path.write_text(OWN)
    loop = Loop(build(load_configuration(path), speed=None))
    loop.services.tell = told.append

    def wait(_record: CycleRecord, _frame: Frame | None) -> None:
        opening = [each for each in loop.listeners if isinstance(each, LastRecording)]
        assert eventually(lambda: not any(each._is_beginning for each in opening))

    with attend_to_requests(loop, []):
        loop.listeners.append(wait)
        loop.run(Limits(frames=frames))
    return path, told


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the configuration of a run of 200 s, by its own clock."""
    path, told = run_room(tmp_path_factory.mktemp("device"), 1000)
    assert told == []
    return path


@pytest.mark.long
def test_one_recording_follows_another_without_pictures_and_each_replays_to_the_same_decisions(device):
    files = list(last_folder(device).iterdir())
    assert len(files) == 4
    times_s: list[float] = []
    for file in files:
        for cycle, observation, decision in replay_run(read_recording(file), None):
            assert cycle.record().decision == decision
            times_s.append(observation.now_s)
        assert b"image" not in file.read_bytes()
    assert len(set(times_s)) == len(times_s) > 950


def test_what_is_too_old_goes_and_a_wrong_clock_fills_no_disk(tmp_path):
    for number, (ago_s, size) in enumerate([(10, 400), (50, 400), (-9e8, 150), (70, 1)]):
        file = tmp_path / f"{number}.mcap"
        file.write_bytes(bytes(size))
        os.utime(file, (time.time() - ago_s,) * 2)
    (tmp_path / "mine.jsonl").touch()
    delete_old(tmp_path, 60, 600)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["0.mcap", "2.mcap", "mine.jsonl"]


def test_a_run_that_cannot_keep_it_says_so_once_and_goes_on(tmp_path):
    (tmp_path / "recordings").write_text("in the way")
    _, told = run_room(tmp_path, 300)
    assert [words.partition("recorded: ")[0] for words in told] == ["warning: the last 1 min: nothing is "]


def test_a_change_of_it_needs_a_restart_and_less_than_a_minute_is_refused(tmp_path):
    path = tmp_path / "room.toml"
    path.write_text(OWN)
    old = load_configuration(path)
    path.write_text(OWN.replace("1 min", "2 h"))
    assert needs_restart(old, load_configuration(path)) == ("[recording]",)
    path.write_text(OWN.replace("1 min", "5 s"))
    with pytest.raises(ConfigError, match=r"recording\.last"):
        load_configuration(path)
