"""Recordings and the timeline on the page: any moment of one, and what other rules would have done."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.app.control.client import ask as ask_run
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.event_log import EventLog
from stadimeter.app.recordings.journal import RecordedConfiguration, to_be_recorded
from stadimeter.app.recordings.recording import ImageOptions, Recorded, RecordingWriter
from stadimeter.app.timeline import TimelineKeeper, event_log_beside
from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.command import LevelCommand
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Decision, Event, EventKind, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement, MeasurementStatus, Track, TrackStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import ConfigError, JournalError, NotThereError
from stadimeter.ranging.ball import BallShape
from stadimeter.workbench.replay import read_index
from stadimeter.workbench.server import timeline
from stadimeter.workbench.server.operations import Desk, find_operation
from stadimeter.workbench.trial import Passage
from support.observing import Rehearsal
from support.saves import CONFIGURATION, LENS
from support.simulated_run import SIMULATED_BALL

# Recordings on the page: the list, any moment of one, and names that lead nowhere.

TEXT = '[rules.near]\nwhen = { below = "1 m" }\n'
RECORDED = Recorded(
    configuration=RecordedConfiguration(text=TEXT), camera=CameraModel.with_focal_length(60.0, 64, 48), sizes={}
)
PLAN = Plan(
    targets=("ball",),
    rules=(AlarmRule(name="near", target="ball", output="buzzer", condition=DistanceCondition(below=1.0)),),
    outputs=(LevelOutput(name="buzzer"),),
)
PERIOD_S = 0.1


def ask(desk: Desk, op: str, **args: object) -> Any:
    return find_operation(op)(desk, args).data


def records(count: int) -> Iterator[tuple[CycleRecord, Frame]]:
    """Yield cycles whose picture says by its brightness which one it is."""
    rehearsal = Rehearsal(PLAN)
    for number in range(count):
        decision = rehearsal.see(3.0 - number * 0.05)
        now_s = number * PERIOD_S
        seen = Observation(now_s=now_s, frame=FrameStamp(captured_at_s=now_s, sequence=number))
        record = CycleRecord(observation=seen, decision=decision, applied=(), timings_s={})
        yield record, Frame(np.full((48, 64, 3), 2 * number, np.uint8), now_s, number)


def record(path: Path, count: int = 50, options: ImageOptions | None = None) -> Path:
    with recording_of(path, count, options):
        pass
    return path


@contextmanager
def recording_of(path: Path, count: int, options: ImageOptions | None = None) -> Iterator[None]:
    """Record, and finish the file at the end of the block."""
    path.parent.mkdir(exist_ok=True)
    writer = RecordingWriter(path, RECORDED, options)
    for each, frame in records(count):
        writer.write(each, frame)
    yield
    writer.close()


def brightness(index: Any, at_s: float) -> int:
    """Return which picture is shown at a moment."""
    moment = index.moment(at_s)
    assert moment.frame is not None
    return round(float(moment.frame.image.mean()) / 2)


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(configuration=tmp_path / "stadimeter.toml", run_socket=tmp_path / "none.sock")


@pytest.fixture
def folder(desk: Desk) -> Path:
    return desk.configuration.parent / "recordings"


def test_any_moment_of_a_recording_comes_with_its_picture_and_its_cycle(tmp_path: Path) -> None:
    index = read_index(record(tmp_path / "run.mcap"))
    assert index.seconds == pytest.approx(49 * PERIOD_S)
    for at_s, number in ((0.0, 0), (0.05, 0), (0.1, 1), (2.54, 25), (1.0, 10), (4.9, 49), (99.0, 49), (-1.0, 0)):
        moment = index.moment(at_s)
        assert moment.cycle.record().observation.frame.sequence == number
        assert moment.at_s == pytest.approx(number * PERIOD_S)
        assert brightness(index, at_s) == number


def test_the_newest_recording_is_listed_first_and_a_damaged_one_says_what_is_wrong(desk: Desk, folder: Path) -> None:
    whole = record(folder / "a.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[:-40])
    (folder / "noise.mcap").write_bytes(b"nothing of ours")
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "notes.txt").write_text("not listed")
    (folder / "link.mcap").symlink_to("a.mcap")
    listed = {each["name"]: each for each in ask(desk, "recordings.recordings")["recordings"]}
    assert set(listed) == {"a.mcap", "cut.mcap", "noise.mcap", "empty.mcap"}
    assert listed["a.mcap"]["seconds"] == pytest.approx(4.9)
    assert (listed["a.mcap"]["damage"], listed["a.mcap"]["configuration"]) == ("", "rules near")
    assert "its end is missing" in listed["cut.mcap"]["damage"]
    assert listed["cut.mcap"]["seconds"] > 0
    for name in ("noise.mcap", "empty.mcap"):
        assert listed[name]["damage"]
        assert listed[name]["seconds"] is None


def test_a_frame_of_a_recording_has_what_was_measured_drawn_in_and_its_values(desk: Desk, folder: Path) -> None:
    measured = Measurement(
        target="ball",
        captured_at_s=0.0,
        status=MeasurementStatus.MEASURED,
        distance_m=1.0,
        sigma_m=0.01,
        depth_m=1.0,
        bearing_rad=0.0,
        elevation_rad=0.0,
    )
    corners = np.array([[20.0, 10.0], [44.0, 10.0], [44.0, 38.0], [20.0, 38.0]])
    outlined = Detection(target="ball", status=DetectionStatus.FOUND, centre_px=(32.0, 24.0), outline_px=corners)
    decision = Rehearsal(PLAN).see(*[1.0] * 10)
    seen = Observation(now_s=0.0, frame=FrameStamp(captured_at_s=0.0, sequence=0), measurements=(measured,))
    folder.mkdir()
    writer = RecordingWriter(folder / "a.mcap", replace(RECORDED, sizes={"ball": BallShape(diameter_m=0.4)}))
    writer.write(
        CycleRecord(
            observation=seen,
            decision=decision,
            applied=(LevelCommand(output="buzzer", level=0.4),),
            timings_s={},
            detections=(outlined,),
        ),
        Frame(np.full((48, 64, 3), 90, np.uint8), 0.0, 0),
    )
    writer.close()
    drawn = find_operation("recordings.recording_frame")(desk, {"name": "a.mcap", "at_s": 0})
    plain = find_operation("recordings.recording_frame")(desk, {"name": "a.mcap", "at_s": 0, "draw": "plain"})
    pictures = [cv2.imdecode(np.frombuffer(each.attached, np.uint8), cv2.IMREAD_COLOR) for each in (drawn, plain)]
    assert [each.shape for each in pictures] == [(48, 64, 3)] * 2
    assert np.abs(pictures[0].astype(int) - pictures[1]).max() > 40
    values = drawn.data
    assert values["frame"]["sequence"] == 0
    assert values["outputs"][0]["level"] == 0.4
    assert [(each["name"], each["distance_m"]) for each in values["targets"]] == [
        ("ball", pytest.approx(1.0, abs=0.01))
    ]
    assert values["rules"][0]["rule"] == "near"
    json.dumps(values, allow_nan=False)


@pytest.mark.parametrize(
    "name", ["../stadimeter.toml", "../secret.mcap", "/etc/passwd", "", ".", "..", "a.mcap/", "a\0.mcap", "link.mcap"]
)
def test_no_name_leads_out_of_the_folder(desk: Desk, folder: Path, name: str) -> None:
    record(folder / "a.mcap")
    record(folder.parent / "secret.mcap", 3)
    (folder / "link.mcap").symlink_to(folder.parent / "secret.mcap")
    for op in ("recordings.recording_frame", "recordings.delete"):
        with pytest.raises(NotThereError):
            ask(desk, op, name=name)
    assert (folder.parent / "secret.mcap").exists()


def test_a_recording_is_deleted_unless_it_is_being_written(desk: Desk, folder: Path) -> None:
    with recording_of(folder / "a.mcap", 20):
        (listed,) = ask(desk, "recordings.recordings")["recordings"]
        assert listed["is_growing"]
        assert listed["damage"] == ""
        with pytest.raises(JournalError, match="being recorded"):
            ask(desk, "recordings.delete", name="a.mcap")
    assert not ask(desk, "recordings.recordings")["recordings"][0]["is_growing"]
    ask(desk, "recordings.delete", name="a.mcap")
    assert ask(desk, "recordings.recordings")["recordings"] == []


@pytest.mark.parametrize("cycles", [1, 5])
def test_a_recording_in_progress_is_never_damaged_however_young_it_is(desk: Desk, folder: Path, cycles: int) -> None:
    with recording_of(folder / "a.mcap", cycles):
        (listed,) = ask(desk, "recordings.recordings")["recordings"]
        assert listed["is_growing"]
        assert listed["damage"] == ""


def test_clips_are_listed_beside_recordings_with_what_they_are_of_and_are_found_by_their_names(
    desk: Desk, folder: Path
) -> None:
    record(folder / "run.mcap")
    clip_of = {"kind": "raised", "source": "near", "reason": "0.9 m"}
    (folder / "clips").mkdir()
    writer = RecordingWriter(folder / "clips" / "clip.mcap", replace(RECORDED, clip_of=clip_of), anchor_ns=10**18)
    for each, frame in records(20):
        writer.write(each, frame)
    writer.close()
    listed = {each["name"]: each for each in ask(desk, "recordings.recordings")["recordings"]}
    assert {name: each["clip_of"] for name, each in listed.items()} == {
        "run.mcap": None, "clip.mcap": clip_of
    }  # fmt: skip
    for each in listed.values():
        assert each["ended_unix_s"] - each["began_unix_s"] == pytest.approx(each["seconds"])
        assert each["seconds"] > 1
    assert listed["clip.mcap"]["began_unix_s"] == pytest.approx(1e9)
    assert ask(desk, "recordings.delete", name="clip.mcap") == {"name": "clip.mcap"}
    with pytest.raises(NotThereError):
        ask(desk, "recordings.delete", name="clip.mcap")


# What an edited configuration would have done on a recording, as the page draws it.

BEFORE = CONFIGURATION.format(below="1 m")
AFTER = CONFIGURATION.format(below="2 m")
FRAMES = 300
IN_AND_OUT = [3.0 - 2.6 * (1 - abs(frame - FRAMES / 2) / (FRAMES / 2)) for frame in range(FRAMES)]
"""From 3 m to 0.4 m and back, at 30 frames a second."""


@pytest.fixture
def desk_of_walk(tmp_path: Path) -> Desk:
    desk_of_walk = Desk(configuration=tmp_path / "stadimeter.toml", run_socket=tmp_path / "none.sock")
    (tmp_path / "camera.toml").write_text(camera_file_text(LENS))
    desk_of_walk.configuration.write_text(BEFORE)
    configuration = load_configuration(desk_of_walk.configuration)
    (tmp_path / "recordings").mkdir()
    recorded = Recorded(configuration=to_be_recorded(configuration), camera=LENS, sizes={})
    writer = RecordingWriter(tmp_path / "recordings" / "walk.mcap", recorded)

    class Walk(Rehearsal):
        def cycle(self, observation: Observation) -> Decision:
            decision = super().cycle(observation)
            writer.write(CycleRecord(observation=observation, decision=decision, applied=(), timings_s={}))
            return decision

    Walk(configuration.plan, frame_s=1 / 30).see(*IN_AND_OUT)
    writer.close()
    return desk_of_walk


def diff(desk_of_walk: Desk, text: str, **args: object) -> Any:
    return find_operation("replaying.replay_diff")(desk_of_walk, {"name": "walk.mcap", "text": text, **args}).data


def test_a_farther_threshold_is_crossed_earlier_and_left_later(desk_of_walk: Desk) -> None:
    found = diff(desk_of_walk, AFTER)
    (lane,) = found["lanes"]
    (before,), (after,) = lane["before"], lane["after"]
    assert after["from_s"] < before["from_s"] < before["to_s"] < after["to_s"]
    assert before["from_s"] == pytest.approx(2.0 / 2.6 * 5, abs=0.3), "when 1 m was crossed"
    assert after["from_s"] == pytest.approx(1.0 / 2.6 * 5, abs=0.3), "when 2 m was crossed"
    assert found["thresholds_m"] == [2.0]
    assert found["progress"] == 1.0
    assert [(each["change"], each["source"]) for each in found["differences"]] == [("moved", "near")] * 2


def test_a_recording_that_is_damaged_is_compared_up_to_there(desk_of_walk: Desk) -> None:
    file = desk_of_walk.configuration.parent / "recordings" / "walk.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    found = diff(desk_of_walk, AFTER)
    assert (found["progress"], round(found["to_s"])) == (1.0, 5)
    assert any("damaged: its end is missing" in words for words in found["words"])


def test_a_long_recording_is_answered_in_parts_which_come_to_the_same(
    desk_of_walk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = diff(desk_of_walk, AFTER)
    desk_of_walk.kept.clear()
    ticks = iter(range(100_000))
    monkeypatch.setattr(Passage.go_on, "__defaults__", (lambda: next(ticks) / 1000,))
    shares = []
    while not shares or shares[-1] < 1:
        part = diff(desk_of_walk, AFTER, for_s=0.1)
        shares.append(part["progress"])
    assert 2 < len(shares) < 10
    assert shares == sorted(shares)
    assert part == at_once


def test_two_who_compare_at_once_both_come_to_the_end_also_while_the_recording_grows(
    desk_of_walk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = iter(range(100_000))
    monkeypatch.setattr(Passage.go_on, "__defaults__", (lambda: next(ticks) / 1000,))
    recording = desk_of_walk.configuration.parent / "recordings" / "walk.mcap"
    shares = {BEFORE: [0.0], AFTER: [0.0]}
    while min(each[-1] for each in shares.values()) < 1:
        with recording.open("ab") as file:
            file.write(b"\0")
        for text, share in shares.items():
            share.append(diff(desk_of_walk, text, for_s=0.1)["progress"])
            assert share[-1] == 1 or share[-1] > share[-2]
    assert min(map(len, shares.values())) > 3


# The timeline for the page: any stretch of time in steps, events of the log, clips, and what is known of a moment.

RULES = """
[rules.near]
actuator = "motor"
when = { below = "1 m" }
on_delay = "0 s"

[rules.far]
actuator = "motor"
ramp = { from = "2.5 m", to = "3.5 m" }

[world]
"""
BEGAN_S = 1_782_907_200
"""2026-07-01 12:00 UTC."""


def ask_timeline(desk_of_timeline: Desk, op: str, **args: object) -> Any:
    return find_operation(op)(desk_of_timeline, {key.rstrip("_"): value for key, value in args.items()}).data


@pytest.fixture
def desk_of_timeline(tmp_path: Path) -> Desk:
    path = tmp_path / "room.toml"
    path.write_text(SIMULATED_BALL + RULES)
    return Desk(configuration=path, run_socket=tmp_path / "none.sock")


@pytest.fixture
def timeline_folder(desk_of_timeline: Desk) -> Path:
    return desk_of_timeline.configuration.parent / "timeline" / "room"


def keep(
    timeline_folder: Path,
    distances_m: list[float | None],
    began_s: int = BEGAN_S,
    rule: str = "near",
    run_rate: float = 1.0,
) -> None:
    """Keep a second for each distance; nearer than 1 m the rule is active. The run's clock has its own rate."""
    times = iter(range(began_s, began_s + len(distances_m)))
    keeper = TimelineKeeper(timeline_folder, 1e9, lambda: next(times))
    for second, metres in enumerate(distances_m):
        status = TrackStatus.LOST if metres is None else TrackStatus.TRACKING
        track = Track(target="ball", status=status, distance_m=metres, sigma_m=0.02)
        trace = RuleTrace(rule=rule, status=RuleStatus.ACTIVE if (metres or 9) < 1 else RuleStatus.IDLE)
        decision, observation = (
            SimpleNamespace(tracks=(track,), rules=(trace,)),
            SimpleNamespace(now_s=run_rate * second),
        )
        keeper(SimpleNamespace(decision=decision, observation=observation))  # type: ignore[arg-type]
        keeper.step()
    keeper.close()


def test_a_stretch_is_answered_in_steps_with_extremes_gaps_and_lanes(
    desk_of_timeline: Desk, timeline_folder: Path
) -> None:
    keep(timeline_folder, [2.0] * 60 + [None] * 60 + [2.0, 0.5, 2.0] + [2.0] * 57)
    found = ask_timeline(desk_of_timeline, "timeline.timeline", from_=BEGAN_S - 60, to=BEGAN_S + 240, points=5)
    assert (found["from_s"], found["step_s"], found["count"]) == (BEGAN_S - 60, 60, 5)
    assert found["targets"]["ball"]["low_m"] == [None, 2.0, None, 0.5, None]
    assert found["targets"]["ball"]["high_m"] == [None, 2.0, None, 2.0, None]
    assert found["targets"]["ball"]["mean_m"][3] == pytest.approx(2.0 - 1.5 / 60, abs=1e-3)
    assert found["lanes"] == [
        {"rule": "near", "spans": [(BEGAN_S, BEGAN_S + 120, "idle"), (BEGAN_S + 120, BEGAN_S + 180, "active")]}
    ]
    assert found["is_kept"]


@pytest.mark.parametrize("stretch", [(5, 5), (9, 5), (-1, 5), (0, 1e9)])
def test_a_stretch_that_is_none_is_refused(desk_of_timeline: Desk, stretch: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match="at most 366 days"):
        ask_timeline(desk_of_timeline, "timeline.timeline", from_=stretch[0], to=stretch[1])


@pytest.mark.parametrize("is_service", [True, False])
def test_events_come_from_the_event_log(desk_of_timeline: Desk, timeline_folder: Path, is_service: bool) -> None:
    timeline_folder.mkdir(parents=True)
    path = timeline_folder.parents[1] / "room.log" if is_service else event_log_beside(timeline_folder)
    now = datetime.fromtimestamp(BEGAN_S, UTC)
    log = EventLog(path, now=lambda: now, is_right=lambda: True)
    log.say("started: stadimeter 1, room.toml")
    for kind, by in ((EventKind.RAISED, ""), (EventKind.OUT_OF_SERVICE, "zoe")):
        now += timedelta(seconds=10)
        event = Event(kind=kind, source="near", at_s=0.0, severity=Severity.ALARM, reason="0.45 m: below 1 m", by=by)
        log(SimpleNamespace(decision=SimpleNamespace(events=(event,), safety=SafetyMode.STOPPED)))  # type: ignore[arg-type]
    log.close()
    found = ask_timeline(desk_of_timeline, "timeline.timeline", from_=BEGAN_S - 5, to=BEGAN_S + 15)["events"]
    assert [(each["unix_s"], each["kind"], each["source"], each["reason"]) for each in found] == [
        (BEGAN_S, "", "", "started: stadimeter 1, room.toml"),
        (BEGAN_S + 10, "raised", "near", "0.45 m: below 1 m"),
    ]
    (last,) = ask_timeline(desk_of_timeline, "timeline.timeline", from_=BEGAN_S + 15, to=BEGAN_S + 25)["events"]
    assert (last["kind"], last["by"], last["severity"]) == ("out_of_service", "zoe", "alarm")


def test_thresholds_have_the_names_by_which_they_are_set(desk_of_timeline: Desk) -> None:
    assert ask_timeline(desk_of_timeline, "timeline.marks", from_=0, to=60)["thresholds"] == [
        {"rule": "near", "target": "ball", "key": "below", "value_m": 1.0},
        {"rule": "far", "target": "ball", "key": "ramp", "value_m": 2.5},
    ]
    desk_of_timeline.configuration.write_text("broken")
    assert ask_timeline(desk_of_timeline, "timeline.marks", from_=0, to=60)["thresholds"] == []


class Observed(Rehearsal):
    """A rehearsal that keeps what it was given last."""

    def cycle(self, observation: Observation) -> Decision:
        self.observation = observation
        return super().cycle(observation)


@pytest.fixture
def recorded(desk_of_timeline: Desk) -> float:
    """Record two minutes as a clip; the ball is near from the second minute on. Return when it began."""
    rehearsal = Observed(load_configuration(desk_of_timeline.configuration).plan)
    path = desk_of_timeline.configuration.parent / "recordings" / "clips" / "one.mcap"
    path.parent.mkdir(parents=True)
    text = RecordedConfiguration(text=desk_of_timeline.configuration.read_text())
    camera = CameraModel.with_focal_length(60.0, 64, 48)
    writer = RecordingWriter(path, Recorded(configuration=text, camera=camera, sizes={}))
    began_s = time.time()
    for number in range(1200):
        decision = rehearsal.see(2.0 if number < 600 else 0.5)
        writer.write(CycleRecord(observation=rehearsal.observation, decision=decision, applied=(), timings_s={}))
    writer.close()
    os.utime(path, (began_s + 120, began_s + 120))
    return began_s


@pytest.mark.long
def test_a_moment_that_a_recording_holds_is_explained_by_it(desk_of_timeline: Desk, recorded: float) -> None:
    for after_s, status, words in ((30, "idle", "2.000 m"), (110, "active", "0.500 m")):
        found = ask_timeline(desk_of_timeline, "timeline.moment", at=recorded + after_s)
        assert (found["by"], found["recording"]) == ("recording", "one.mcap")
        near = next(each for each in found["rules"] if each["rule"] == "near")
        assert near["status"] == status
        assert words in near["reason"]


@pytest.mark.long
def test_a_moment_of_a_run_that_lagged_is_explained_by_the_clock_of_the_run(
    desk_of_timeline: Desk, timeline_folder: Path, recorded: float
) -> None:
    """Two minutes of a run took four by the computer's clock: after 100 s the ball is not near yet."""
    keep(timeline_folder, [2.0] * 240, began_s=int(recorded), run_rate=0.5)
    path = desk_of_timeline.configuration.parent / "recordings" / "clips" / "one.mcap"
    os.utime(path, (recorded + 240, recorded + 240))
    for after_s, status in ((100, "idle"), (200, "active")):
        found = ask_timeline(desk_of_timeline, "timeline.moment", at=recorded + after_s)
        near = next(each for each in found["rules"] if each["rule"] == "near")
        assert (found["held_by"], near["status"]) == ("clips/one.mcap", status)
        assert found["since_s"] == pytest.approx(after_s / 2, abs=1.5)


def test_a_moment_of_the_last_minute_is_explained_by_the_run(
    desk_of_timeline: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = {"rule": "near", "status": "idle", "sentence": "idle: 2.0 m", "evidence": []}

    def answer(_socket: Path, op: str, args: dict[str, float], wait_s: float) -> dict[str, Any]:
        assert (op, wait_s > 0) == ("explain", True)
        assert args["at_unix_s"] == pytest.approx(time.time(), abs=30)
        return {"rules": [told]}

    assert ask_run is timeline.ask
    monkeypatch.setattr(timeline, "ask", answer)
    found = ask_timeline(desk_of_timeline, "timeline.moment", at=time.time() - 5)
    assert found["by"] == "run"
    assert found["rules"] == [{"rule": "near", "status": "idle", "reason": "idle: 2.0 m"}]
