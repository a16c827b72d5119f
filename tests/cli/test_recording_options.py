"""What a run leaves behind, also when the disk fails, hangs or already holds something: real processes and limits."""

from __future__ import annotations

import json
import os
import pty
import resource
import select
import signal
import subprocess
import sys
import tty
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from stadimeter.app.event_log import read_events
from stadimeter.app.timeline import MEAN, event_log_beside, read_rows
from stadimeter.testing.rig import eventually
from stadimeter.workbench.replay import read_mcap, read_recording
from support.command_line import typed
from support.recordings import records_of
from support.simulated_run import SIMULATED_BALL

# What a run leaves behind when the disk fails, hangs or already holds something: real processes and real limits.

SIMULATED = SIMULATED_BALL + '[rules.far]\nactuator = "motor"\nramp = { from = "0.5 m", to = "1 m" }\n[world]\n'
OPTIONS = [("--journal", "run.jsonl"), pytest.param("--record", "run.mcap", marks=pytest.mark.long)]


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "stadimeter", "run", *map(str, words)]


def run_on_a_small_disk(*words: object, limit_bytes: int) -> subprocess.CompletedProcess[str]:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, resource.RLIM_INFINITY))

    return subprocess.run(command(*words), capture_output=True, text=True, check=False, preexec_fn=limit)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "simulated.toml"
    path.write_text(SIMULATED)
    return path


@pytest.mark.long
@pytest.mark.parametrize(("option", "name"), OPTIONS)
def test_a_disk_that_fills_up_ends_the_file_intact_and_the_run_goes_on(
    config: Path, tmp_path: Path, option: str, name: str
) -> None:
    """A limit on the size of files stands in for the disk: the system cuts a write short in the same way."""
    path = tmp_path / name
    done = run_on_a_small_disk(config, "--seconds", 60, "--speed", 0, option, path, limit_bytes=400_000)
    assert done.returncode == 0, done.stderr
    assert "Ended: 60 s, as asked for. 1800 frames" in done.stdout
    first, last = done.stderr.splitlines()
    assert first.endswith("the run goes on without it")
    assert "is not whole: " in last
    cycles = list(records_of(read_recording(path)))
    assert 50 < len(cycles) < 1800
    assert path.stat().st_size <= 400_000
    if name.endswith("jsonl"):
        assert path.read_bytes().endswith(b"}\n")


@pytest.mark.long
def test_the_run_goes_on_also_where_its_warnings_go_to_the_disk_that_is_full(config: Path) -> None:
    """As with those of a run that a page has started: it keeps them in a file."""
    words = command(config, "--seconds", 5, "--speed", 0, "--journal", "/dev/full")
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(words, stdout=subprocess.PIPE, stderr=full, text=True, check=False)
    assert "Ended: 5 s, as asked for." in done.stdout


@pytest.mark.parametrize(("option", "name"), OPTIONS)
def test_a_restart_replaces_no_record_of_an_earlier_run_and_says_where_that_is(
    config: Path, tmp_path: Path, option: str, name: str
) -> None:
    path = tmp_path / name
    counts = {}
    for frames in (20, 30, 40):
        done = typed("run", config, "--frames", frames, "--speed", 0, option, path)
        assert done.returncode == 0, done.stderr
        counts[frames] = done.stderr
    assert counts[20] == ""
    for number, frames in ((1, 30), (2, 40)):
        assert counts[frames].endswith(f", which is now {path.with_stem(f'run-{number}')}\n")
    lengths = [len(list(records_of(read_recording(path.with_stem(stem))))) for stem in ("run-1", "run-2", "run")]
    assert lengths == [20, 30, 40]


@pytest.mark.long
def test_the_journal_of_a_run_that_was_killed_is_still_there_after_the_restart(config: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    with subprocess.Popen(command(config, "--journal", path), stdout=subprocess.DEVNULL) as killed:
        eventually(lambda: path.exists() and path.read_bytes().count(b"\n") > 20)
        killed.kill()
    crashed = path.read_bytes()
    assert typed("run", config, "--frames", 3, "--speed", 0, "--journal", path).returncode == 0
    assert (tmp_path / "run-1.jsonl").read_bytes() == crashed


def test_a_run_that_begins_no_cycle_leaves_an_older_journal_where_it_is(config: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    assert typed("run", config, "--frames", 3, "--speed", 0, "--journal", path).returncode == 0
    before = path.read_bytes()
    camera = '[camera]\ndriver = "opencv"\ndevice = "/dev/video-none"\n'
    config.write_text(SIMULATED.replace(SIMULATED[: SIMULATED.index("[camera.model]")], camera))
    assert typed("run", config, "--no-state", "--journal", path).returncode == 2
    assert path.read_bytes() == before
    assert sorted(each.name for each in tmp_path.glob("run*")) == ["run.jsonl"]


@pytest.fixture
def stuck() -> Iterator[int]:
    """Return a terminal that takes a few kilobytes and then hangs, as a disk may: its other side is never read."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    yield theirs
    os.close(ours)
    os.close(theirs)


@pytest.mark.long
def test_a_disk_that_hangs_does_not_keep_a_run_from_ending_on_sigterm(config: Path, stuck: int) -> None:
    words = command(config, "--speed", 0, "--journal", os.ttyname(stuck))
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        assert run.stdout.readline()
        eventually(lambda: not select.select([], [stuck], [], 0.1)[1])  # the terminal is full
        run.send_signal(signal.SIGTERM)
        out, err = run.communicate(timeout=120)  # without a bound, it would be never
    assert run.returncode == 0, err
    assert "Ended: SIGTERM" in out
    assert "the disk does not answer; the end of the journal is missing" in err


def test_a_run_that_did_not_open_leaves_no_file_behind(tmp_path: Path) -> None:
    camera = f'[camera]\ndriver = "opencv"\ndevice = "{tmp_path / "no-camera"}"\n'
    text = SIMULATED.replace('[camera]\ndriver = "simulated"\nrate = "30 Hz"\nrender = false\n', camera)
    ball = '"ball"\ndiameter = "7 cm"\nhsv = "29,86,6:64,255,255"'
    (tmp_path / "config.toml").write_text(text.replace('"ideal"', ball))
    old = tmp_path / "old.jsonl"
    old.touch()
    for journal in (tmp_path / "run.jsonl", old):
        done = typed("run", tmp_path / "config.toml", "--journal", journal, "--state", tmp_path / "state")
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "there is no camera" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["config.toml", "old.jsonl"]


# A run keeps its timeline: as a service, or where its configuration says so; a kill leaves what was written.

ROOM = f"""{SIMULATED_BALL}
[rules.near]
actuator = "motor"
when = {{ below = "3 m" }}
on_delay = "0 s"
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
"""


def start(folder: Path, table: str, **environ: str) -> subprocess.Popen[bytes]:
    path = folder / "room.toml"
    path.write_text(table + ROOM)
    command = [sys.executable, "-m", "stadimeter", "run", str(path), "--no-state"]
    own = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
    own.pop("STATE_DIRECTORY", None)
    return subprocess.Popen(command, env={**own, **environ}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.mark.long
@pytest.mark.parametrize("is_service", [True, False])
def test_a_run_that_is_killed_has_kept_its_first_second_and_its_events(tmp_path: Path, is_service: bool) -> None:
    state = tmp_path / "state"
    state.mkdir()
    if is_service:
        run = start(tmp_path, "", STATE_DIRECTORY=str(state))
    else:
        run = start(tmp_path, '[timeline]\nkeep = "1 d"\n')
    folder = (state if is_service else tmp_path) / "timeline" / "room"
    log = state / "room.log" if is_service else event_log_beside(folder)
    try:
        eventually(lambda: list(read_rows(folder, 0, 2**32, 1)) and list(read_events(log, 0, 2**32)))
    finally:
        run.send_signal(signal.SIGKILL)
        run.wait()
    ((names, rows),) = read_rows(folder, 0, 2**32, 1)
    assert (names.targets, names.rules) == (("ball",), ("near",))
    mean_m = rows["figures"][0, 0, MEAN]  # of a second that was over before the ball was tracked there is none
    assert np.isnan(mean_m) or mean_m == pytest.approx(2.0, abs=0.1)
    assert [each.reason[:7] for each in read_events(log, 0, 2**32)][-1] == "started"


@pytest.mark.long
@pytest.mark.parametrize(("table", "environ"), [("", {}), ('[timeline]\nkeep = "0 s"\n', {"STATE_DIRECTORY": "state"})])
def test_a_run_at_a_desk_without_a_table_and_one_that_shall_keep_nothing_leave_no_folder(
    tmp_path: Path, table: str, environ: dict[str, str]
) -> None:
    (tmp_path / "state").mkdir()
    own = {name: str(tmp_path / value) for name, value in environ.items()}
    run = start(tmp_path, table, **own)
    eventually(lambda: list(tmp_path.rglob("*.sock")))
    run.send_signal(signal.SIGTERM)
    run.wait()
    assert not list(tmp_path.rglob("timeline"))


# Clips by order: in another terminal, across a reload, and in a run that is asked to end meanwhile.

WORLD = '\n[world]\npath = [{ at = "0 s", x = "2 m", y = "0 m" }]\nloop = false\n'
RULE = '\n[rules.near]\nactuator = "motor"\nwhen = { below = "1 m" }\n'
BOX = '\n[black_box]\nbefore = "30 s"\nafter = "60 s"\non = ["fault"]\n'


@pytest.mark.long
def test_a_clip_spans_a_reload_ends_whole_at_sigterm_and_replays(tmp_path: Path) -> None:
    path = tmp_path / "door.toml"
    path.write_text(SIMULATED_BALL + RULE + BOX + WORLD)
    folders = {"XDG_RUNTIME_DIR": str(tmp_path / "r"), "XDG_STATE_HOME": str(tmp_path / "s")}
    environ = {name: value for name, value in os.environ.items() if not name.endswith("_DIRECTORY")} | folders
    command = [sys.executable, "-m", "stadimeter", "run", str(path)]
    run = subprocess.Popen(command, env=environ, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        eventually(lambda: typed("status", env=environ).returncode == 0)
        path.write_text(path.read_text().replace("1 m", "3 m"))
        assert typed("reload", env=environ).returncode == 0
        done = typed("record", "--clip", "--by", "zoe", "--why", "a noise", "--json", env=environ)
        assert done.returncode == 0
        clip = tmp_path / "recordings" / "clips" / json.loads(done.stdout)["clip"]
        eventually(clip.exists)
        eventually(lambda: "near: active" in typed("status", env=environ).stdout)
    finally:
        run.send_signal(signal.SIGTERM)
        _, said = run.communicate(timeout=60)
    assert "black box" not in said
    found = read_mcap(clip)
    assert not found.is_cut_off()
    assert found.clip_of == {"kind": "order", "source": "zoe", "reason": "a noise"}
    assert any(cycle.reloaded is not None for cycle in found.cycles())
    replayed = typed("replay", str(clip), "--strict", env=environ)
    assert replayed.returncode == 0
    assert "raised" in replayed.stdout
    explained = typed("explain", "near", "--journal", str(clip), env=environ)
    assert "near" in explained.stdout
    assert explained.returncode == 0


def test_a_configuration_says_what_its_black_box_takes_and_what_is_wrong_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from stadimeter.app.this_computer import warnings_here
    from stadimeter.config.describe import describe
    from stadimeter.config.loader import load_configuration
    from stadimeter.errors import ConfigError

    path = tmp_path / "door.toml"
    path.write_text(SIMULATED_BALL + RULE + BOX + 'memory = "16 MB"\n' + WORLD)
    words = "Keeps the last 30 s with pictures in at most 16 MB of memory, and writes a clip on each fault: "
    assert words + "500 MB of clips at most." in describe(load_configuration(path))
    wrong = 'before = "0.5 s"\nafter = "1 h"\nrate = "0 Hz"\nquality = 101\nmemory = "1 MB"\nmax_total = "5"\n'
    wrong += 'on = ["all"]\n'
    path.write_text(SIMULATED_BALL + RULE + "\n[black_box]\n" + wrong + WORLD)
    with pytest.raises(ConfigError) as caught:
        load_configuration(path)
    keys = {"before", "after", "rate", "quality", "memory", "max_total", "on"}
    assert {problem.key.split(".")[1] for problem in caught.value.problems} == keys
    monkeypatch.setattr("stadimeter.app.this_computer.missing", lambda extra: f"no {extra}")
    path.write_text(SIMULATED_BALL + RULE + BOX + WORLD)
    assert "the black box cannot write: no record" in [each.message for each in warnings_here(load_configuration(path))]
    path.write_text(SIMULATED_BALL + RULE + '[buttons.front]\ndriver = "simulated"\npress = "clip"\n' + WORLD)
    (warning,) = (each for each in load_configuration(path).warnings if each.code == "no-black-box")
    assert "there is no black box" in warning.message
