"""Recordings on the page: the list, any moment of one, and names that lead nowhere."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration
from stadimeter.app.recordings.recording import ImageOptions, Recorded, RecordingWriter
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.command import LevelCommand
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import JournalError, NotThereError
from stadimeter.ranging.ball import BallShape
from stadimeter.workbench.replay.recording_reader import read_index
from stadimeter.workbench.server.operations import Desk, find_operation
from support.observing import Rehearsal

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
    writer = (
        RecordingWriter(path, RECORDED, options)
        if path.suffix == ".mcap"
        else JournalWriter(path, RECORDED.configuration)
    )
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
    record(folder / "b.jsonl")
    (folder / "cut.mcap").write_bytes(whole[:-40])
    (folder / "noise.mcap").write_bytes(b"nothing of ours")
    (folder / "empty.jsonl").write_bytes(b"")
    (folder / "notes.txt").write_text("not listed")
    (folder / "link.mcap").symlink_to("a.mcap")
    listed = {each["name"]: each for each in ask(desk, "recordings.recordings")["recordings"]}
    assert set(listed) == {"a.mcap", "b.jsonl", "cut.mcap", "noise.mcap", "empty.jsonl"}
    for name in ("a.mcap", "b.jsonl"):
        assert listed[name]["seconds"] == pytest.approx(4.9)
        assert (listed[name]["damage"], listed[name]["configuration"]) == ("", "rules near")
    assert "its end is missing" in listed["cut.mcap"]["damage"]
    assert listed["cut.mcap"]["seconds"] > 0
    for name in ("noise.mcap", "empty.jsonl"):
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
    decision = Rehearsal(PLAN).see(*[1.0] * 10)
    seen = Observation(now_s=0.0, frame=FrameStamp(captured_at_s=0.0, sequence=0), measurements=(measured,))
    folder.mkdir()
    writer = RecordingWriter(folder / "a.mcap", replace(RECORDED, sizes={"ball": BallShape(diameter_m=0.4)}))
    writer.write(
        CycleRecord(
            observation=seen, decision=decision, applied=(LevelCommand(output="buzzer", level=0.4),), timings_s={}
        ),
        Frame(np.full((48, 64, 3), 90, np.uint8), 0.0, 0),
    )
    writer.close()
    drawn = find_operation("recordings.recording_frame")(desk, {"name": "a.mcap", "at_s": 0})
    plain = find_operation("recordings.recording_frame")(desk, {"name": "a.mcap", "at_s": 0, "draw": "plain"})
    images = [cv2.imdecode(np.frombuffer(each.attached, np.uint8), cv2.IMREAD_COLOR) for each in (drawn, plain)]
    assert all(image is not None and image.shape == (48, 64, 3) for image in images)
    change = np.abs(images[0].astype(int) - images[1].astype(int)).max(axis=2)
    rows, columns = np.nonzero(change[20:] > 40)
    assert change[30:34, 30:34].max() < 40, "nothing is drawn between centre and rim"
    assert (columns.min(), columns.max()) == (pytest.approx(31.5 - 12, abs=3), pytest.approx(31.5 + 12, abs=3))
    assert rows.max() + 20 == pytest.approx(23.5 + 12, abs=3)
    values = drawn.data
    assert values["frame"]["sequence"] == 0
    assert values["outputs"][0]["level"] == 0.4
    assert [(each["name"], each["distance_m"]) for each in values["targets"]] == [
        ("ball", pytest.approx(1.0, abs=0.01))
    ]
    assert values["rules"][0]["rule"] == "near"
    json.dumps(values, allow_nan=False)


def test_a_journal_has_no_pictures_and_says_so(desk: Desk, folder: Path) -> None:
    record(folder / "b.jsonl", 3)
    with pytest.raises(JournalError, match="has no pictures"):
        ask(desk, "recordings.recording_frame", name="b.jsonl", at_s=0)


def test_no_folder_of_recordings_is_an_empty_list(desk: Desk) -> None:
    assert ask(desk, "recordings.recordings")["recordings"] == []


@pytest.mark.parametrize(
    "name", ["../stadimeter.toml", "../secret.mcap", "/etc/passwd", "", ".", "..", "a.mcap/", "a\0.mcap", "link.mcap"]
)
def test_no_name_leads_out_of_the_folder(desk: Desk, folder: Path, name: str) -> None:
    record(folder / "a.mcap")
    record(folder.parent / "secret.mcap", 3)
    (folder / "link.mcap").symlink_to(folder.parent / "secret.mcap")
    for op in ("recordings.recording", "recordings.recording_frame", "recordings.delete"):
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


@pytest.mark.parametrize("ending", ["mcap", "jsonl"])
@pytest.mark.parametrize("cycles", [0, 5])
def test_a_recording_in_progress_is_never_damaged_however_young_it_is(
    desk: Desk, folder: Path, cycles: int, ending: str
) -> None:
    with recording_of(folder / f"a.{ending}", cycles):
        (listed,) = ask(desk, "recordings.recordings")["recordings"]
        assert listed["is_growing"]
        assert listed["damage"] == ""


def test_clips_are_listed_beside_recordings_with_what_they_are_of_and_are_found_by_their_names(
    desk: Desk, folder: Path
) -> None:
    record(folder / "run.mcap")
    record(folder / "run.jsonl")
    clip_of = {"kind": "raised", "source": "near", "reason": "0.9 m"}
    (folder / "clips").mkdir()
    writer = RecordingWriter(folder / "clips" / "clip.mcap", replace(RECORDED, clip_of=clip_of), anchor_ns=10**18)
    for each, frame in records(20):
        writer.write(each, frame)
    writer.close()
    listed = {each["name"]: each for each in ask(desk, "recordings.recordings")["recordings"]}
    assert {name: each["clip_of"] for name, each in listed.items()} == {
        "run.mcap": None, "run.jsonl": None, "clip.mcap": clip_of
    }  # fmt: skip
    for each in listed.values():
        assert each["ended_unix_s"] - each["began_unix_s"] == pytest.approx(each["seconds"])
        assert each["seconds"] > 1
    assert listed["clip.mcap"]["began_unix_s"] == pytest.approx(1e9)
    assert ask(desk, "recordings.recording", name="clip.mcap")["path"] == str(folder / "clips" / "clip.mcap")
    assert ask(desk, "recordings.delete", name="clip.mcap") == {"name": "clip.mcap"}
    with pytest.raises(NotThereError):
        ask(desk, "recordings.recording", name="clip.mcap")
