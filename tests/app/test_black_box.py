"""The black box: what its clips hold, when they begin and end, and what becomes of them when the disk fails."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.control import black_box as black_box_module
from stadimeter.app.control.black_box import LONGER_MAX_S, BlackBox, BlackBoxMemory
from stadimeter.app.control.messages import OutputsArgs, Reply
from stadimeter.app.control.recording import LastRecording, delete_old, last_folder
from stadimeter.app.control.reloading import needs_restart
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.journal import RecordedConfiguration
from stadimeter.app.recordings.recording import Recorded
from stadimeter.app.watching import attend_to_requests
from stadimeter.cli.run_services import open_black_box
from stadimeter.config.loader import load_configuration
from stadimeter.config.optional_tables import BlackBoxTable
from stadimeter.core.frame import Frame
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError
from stadimeter.testing.rig import eventually
from stadimeter.workbench.replay import McapRecording, read_mcap, read_recording, replay_run
from support.observing import Rehearsal
from support.simulated_run import SIMULATED_BALL

# The ball comes near at 5 s, and every 10 s from then on.
ROOM = f"""{SIMULATED_BALL.replace('rate = "30 Hz"', 'rate = "10 Hz"')}
[rules.near]
actuator = "motor"
when = {{ below = "1 m" }}
on_delay = "0 s"
[world]
path = [
  {{ at = "0 s", x = "2 m", y = "0 m" }}, {{ at = "4 s", x = "2 m", y = "0 m" }},
  {{ at = "5 s", x = "0.5 m", y = "0 m" }}, {{ at = "6 s", x = "2 m", y = "0 m" }},
  {{ at = "10 s", x = "2 m", y = "0 m" }},
]
"""


class Room:
    """A run of the room with a black box.

    Attributes:
        told: What a person was shown.
        answers: What orders were answered.
    """

    def __init__(self, folder: Path, table: str, more: str = "") -> None:
        self.path = folder / "room.toml"
        self.path.write_text(f"{ROOM}{more}\n[black_box]\n{table}\n")
        self.loop = Loop(build(load_configuration(self.path), speed=None))
        self.told: list[str] = []
        self.answers: list[Any] = []
        self.loop.services.tell = self.told.append
        self.clips_folder = folder / "recordings" / "clips"

    def run(self, seconds: float, each: Callable[[float, BlackBox], None] = lambda _now_s, _box: None) -> list[Path]:
        """Run, and return its clips; ``each`` is called after each cycle."""
        with ExitStack() as closing:
            open_black_box(self.loop, closing)
            box = self.loop.services.black_box
            assert box is not None
            self.loop.listeners.append(lambda record, _frame: each(record.observation.now_s, box))
            self.loop.run(Limits(seconds=seconds))
        return self.clips

    @property
    def clips(self) -> list[Path]:
        return sorted(self.clips_folder.glob("*.mcap"))

    def order(self, box: BlackBox, by: str = "zoe") -> None:
        box.act(OutputsArgs(by=by, why="what was that?"), self.answers.append)


def span_of(path: Path) -> tuple[float, float]:
    """Return from when until when a clip lasts, after it was replayed to the same decisions."""
    clip = read_mcap(path)
    assert not clip.is_cut_off()
    times = []
    for cycle, _, decision in replay_run(clip, None):
        assert cycle.record().decision == decision
        times.append(cycle.now_s())
    return times[0], times[-1]


def test_an_alarm_is_in_a_clip_with_what_came_before_and_after_and_nothing_else_is_written(tmp_path):
    room = Room(tmp_path, 'before = "3 s"\nafter = "2 s"')
    written: dict[float, bool] = {}
    (clip,) = room.run(9, lambda now_s, _box: written.__setitem__(now_s, room.clips_folder.exists()))
    began_s, ended_s = span_of(clip)
    (raised_s,) = (
        cycle.now_s() for cycle in read_mcap(clip).cycles() if any(e.kind == "raised" for e in cycle.decision().events)
    )
    assert raised_s - 4.2 <= began_s <= raised_s - 3
    assert raised_s + 2 <= ended_s <= raised_s + 2.2
    assert not any(is_written for at_s, is_written in written.items() if at_s < raised_s)
    assert read_mcap(clip).clip_of == {"kind": "raised", "source": "near", "reason": room.loop.history.events[1].reason}
    assert room.told == []


def test_a_camera_that_stands_still_is_in_a_clip_too(tmp_path):
    room = Room(tmp_path, 'on = ["fault"]\nbefore = "1 s"\nafter = "2 s"')
    text = room.path.read_text()
    room.path.write_text(
        text.replace("[world]", '[world]\nfaults = [{ at = "3 s", for = "1 s", kind = "freeze-camera" }]')
    )
    room.loop = Loop(build(load_configuration(room.path), speed=None))
    (clip,) = room.run(8)
    began_s, ended_s = span_of(clip)
    assert began_s <= 2.2
    assert ended_s >= 5
    assert read_mcap(clip).clip_of["kind"] == "fault"


@pytest.mark.long
def test_what_happens_during_a_clip_makes_it_longer_and_after_a_minute_another_one_begins(tmp_path):
    room = Room(tmp_path, 'before = "2 s"\nafter = "10.5 s"\nrate = "1 Hz"')
    first, second = room.run(85)
    began_s, ended_s = span_of(first)
    assert LONGER_MAX_S < ended_s - began_s < LONGER_MAX_S + 2 + 10.5 + 2
    other_began_s, _ = span_of(second)
    assert other_began_s < ended_s
    assert room.loop.reporter.clips == {"near": second.name}


def test_an_order_is_answered_with_the_name_of_its_clip_and_an_alarm_meanwhile_has_the_same(tmp_path):
    room = Room(tmp_path, 'before = "1 s"\nafter = "3 s"')
    (clip,) = room.run(9, lambda now_s, box: room.order(box) if now_s == pytest.approx(2.5) else None)
    (answer,) = room.answers
    assert answer.data["clip"] == clip.name
    assert answer.data["words"] == f"{clip.name} will hold the last 1 s and the next 3 s"
    assert read_mcap(clip).clip_of == {"kind": "order", "source": "zoe", "reason": "what was that?"}
    assert room.loop.reporter.clips == {"near": clip.name}
    assert span_of(clip)[1] >= 4.6 + 3


PRESS = '\n[buttons.front]\ndriver = "simulated"\npresses = [{ at = "2 s", for = "0.3 s" }]\n'


@pytest.mark.parametrize(
    ("on", "press", "count"), [("[]", "clip", 1), ('["button"]', "acknowledge", 1), ("[]", "acknowledge", 0)]
)
def test_a_button_of_its_own_writes_a_clip_and_any_other_if_that_is_wanted(tmp_path, on, press, count):
    room = Room(tmp_path, f"on = {on}", f'{PRESS}press = "{press}"\n')
    clips = room.run(4)
    told = [read_mcap(clip).clip_of for clip in clips]
    assert told == [{"kind": "button", "source": "button front", "reason": press}] * count


def test_what_the_memory_has_no_room_for_is_missing_at_the_beginning_and_said(tmp_path):
    memory, feed = feeding(tmp_path, memory="4 MB", before="60 s")
    feed(1, 19)
    memory.begin_clip(tmp_path / "clips" / "room.mcap", {"kind": "order"}, 0)
    feed(20, 2)
    memory.finish_clip()
    times = times_of(read_mcap(tmp_path / "clips" / "room.mcap"))
    assert memory.trouble().startswith("its memory holds less than 60 s; raise memory")
    assert 5 < times[0] < 20
    assert times[-1] == pytest.approx(21.9)


@pytest.mark.long
def test_a_full_disk_is_said_and_the_next_clip_is_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(black_box_module, "FREE_MIN_BYTES", 1e15)
    room = Room(tmp_path, 'after = "1 s"')

    def make_room(now_s: float, _box: BlackBox) -> None:
        if now_s > 10:
            monkeypatch.setattr(black_box_module, "FREE_MIN_BYTES", 0)

    (clip,) = room.run(18, make_room)
    (words,) = room.told
    assert words.startswith("warning: black box: clip room-")
    assert words.endswith("MB left; make room")
    assert span_of(clip)[0] < 14
    assert room.loop.trouble() == ""


@pytest.mark.long
def test_the_oldest_clips_go_and_those_of_others_stay(tmp_path):
    memory, feed = feeding(tmp_path, memory="4 MB", before="1 s", max_total="10 MB")
    clips = tmp_path / "clips"
    clips.mkdir()
    (clips / "room-2-20260101T000000.000Z.mcap").write_bytes(bytes(9_000_000))
    names = [f"room-20261127T00000{number}.000Z.mcap" for number in range(8)]
    for number, name in enumerate(names):
        memory.begin_clip(clips / name, {"kind": "order"}, 0)
        feed(1 + 8.0 * number, 8)
        memory.finish_clip()
        os.utime(clips / name, (time.time() - 100 + number,) * 2)
    left = sorted(path.name for path in clips.iterdir())
    assert left[0] == "room-2-20260101T000000.000Z.mcap"
    assert left[1:] == names[-len(left[1:]) :]
    assert sum((clips / name).stat().st_size for name in left[1:]) <= 10e6
    assert 2 < len(left) < len(names)
    assert memory.trouble() == ""


def feeding(folder: Path, **table: str) -> tuple[BlackBoxMemory, Callable[[float, float], None]]:
    """Return a memory, and what feeds it with some seconds of noise, from a time on."""
    configuration = RecordedConfiguration(text="")
    box = BlackBoxTable.model_validate(table)
    memory = BlackBoxMemory(Recorded(configuration=configuration), box, "room-????????T??????.???Z.mcap")
    rehearsal = Rehearsal(Plan(targets=("ball",)))
    memory.begin_segment(rehearsal.state)

    def feed(from_s: float, seconds: float) -> None:
        for number in range(round(seconds * 10)):
            now_s = from_s + number / 10
            observation = Observation(now_s=now_s, frame=FrameStamp(sequence=number, captured_at_s=now_s))
            decision = rehearsal.cycle(observation)
            record = CycleRecord(observation=observation, decision=decision, applied=(), timings_s={})
            memory.write(record, frame_of(number, now_s))
            if number % 10 == 9:
                memory.begin_segment(rehearsal.state)

    feed(0, 1)
    return memory, feed


def frame_of(number: int, now_s: float) -> Frame:
    noise = np.random.default_rng(round(now_s * 10)).integers(0, 256, (120, 160, 3), np.uint8)
    return Frame(noise, now_s, number)


def times_of(clip: McapRecording) -> list[float]:
    return [cycle.now_s() for cycle in clip.cycles()]


def test_a_broken_memory_refuses_orders_and_the_run_goes_on(tmp_path, monkeypatch):
    def fail(*_: object) -> None:
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(BlackBoxMemory, "begin_segment", fail)
    room = Room(tmp_path, "")
    assert room.run(3, lambda now_s, box: room.order(box) if now_s > 1.5 and not room.answers else None) == []
    assert room.told == ["warning: black box: ZeroDivisionError: a defect"]
    assert room.answers == [Reply(error="black box: ZeroDivisionError: a defect")]


# What a run keeps of its last hour by itself.


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
