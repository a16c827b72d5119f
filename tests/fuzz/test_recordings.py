"""Whatever a journal or a recording holds, it is read and decided again, or refused in one line that names it."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration, load_recorded
from stadimeter.app.recordings.recording import Recorded, RecordingWriter
from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.frame import Frame
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import ConfigError, JournalError
from stadimeter.workbench.replay import McapRecording, read_recording
from support.observing import Rehearsal
from support.recordings import records_of
from support.replaying import replay

PLAN = Plan(
    targets=("ball",),
    rules=(AlarmRule(name="near", target="ball", output="buzzer", condition=DistanceCondition(below=1.0)),),
    outputs=(LevelOutput(name="buzzer"),),
)
TEXT = """\
[camera]
driver = "simulated"
model = "camera.toml"
[targets.ball]
detector = "ideal"
[world]
"""
SOME, ALL, PARTS = 60, 10_000, 5


class Recording(Rehearsal):
    """A rehearsal that writes each cycle into a journal and into a recording with pictures."""

    def __init__(self, folder: Path) -> None:
        super().__init__(PLAN)
        lens = CameraModel.with_focal_length(60.0, 64, 48)
        save_camera_model(folder / "camera.toml", lens)
        files = {"camera.toml": (folder / "camera.toml").read_text(encoding="utf-8")}
        configuration = RecordedConfiguration(text=TEXT, files=files)
        self.journal = JournalWriter(folder / "run.jsonl", configuration)
        self.recording = RecordingWriter(folder / "run.mcap", Recorded(configuration=configuration, camera=lens))

    def cycle(self, observation: Any) -> Any:
        decision = super().cycle(observation)
        record = CycleRecord(observation=observation, decision=decision, applied=(), timings_s={"decide": 1e-4})
        stamp = observation.frame
        image = np.full((48, 64, 3), 90, np.uint8)
        self.journal.write(record)
        self.recording.write(record, Frame(image, stamp.captured_at_s, stamp.sequence) if stamp else None)
        return decision


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("sound")
    recording = Recording(folder)
    recording.see(5, 4, 3, 0.5, 0.5)
    recording.wait(0.2)
    recording.journal.close()
    recording.recording.close()
    return {name: (folder / name).read_bytes() for name in ("run.jsonl", "run.mcap")}


def read_everything(file: Path, files: Mapping[str, str]) -> None:
    try:
        recording = read_recording(file)
        recording.is_cut_off()
        if isinstance(recording, McapRecording):
            for cycle, image in recording.cycles_and_images():
                cycle.record()
                if image is not None:
                    image.decode()
        else:
            replay(recording, PLAN)
    except JournalError as error:
        assert str(file) in str(error)  # noqa: PT017
        return
    configuration = recording.header.recorded_configuration
    if configuration.text != TEXT or configuration.files != files:  # the sound one takes most of the time
        try:
            load_recorded(configuration, file)
        except ConfigError as error:
            assert all(problem.file for problem in error.problems)  # noqa: PT017


def fuzz(file: Path, sound: bytes, change: Callable[..., bytes], seed: int, count: int) -> None:
    rng = random.Random(seed)  # noqa: S311
    file.write_bytes(sound)
    files = read_recording(file).header.files
    for _ in range(count):
        file.write_bytes(change(rng, sound))
        read_everything(file, files)


@pytest.mark.parametrize("name", ["run.jsonl", "run.mcap"])
def test_what_is_sound_is_read(tmp_path: Path, sound: dict[str, bytes], name: str) -> None:
    (tmp_path / name).write_bytes(sound[name])
    recording = read_recording(tmp_path / name)
    assert len(list(records_of(recording))) == replay(recording, PLAN).cycles > 5
    assert load_recorded(recording.header.recorded_configuration, tmp_path / name).camera_model


def many(*values: object) -> object:
    """Return a case that takes long."""
    return pytest.param(*values, marks=[pytest.mark.long, pytest.mark.timeout(300)])


@pytest.mark.parametrize(("seed", "count"), [(0, SOME), *(many(1 + part, ALL // PARTS) for part in range(PARTS))])
@pytest.mark.parametrize("name", ["run.jsonl", "run.mcap"])
def test_ten_thousand_byte_flips_are_no_tracebacks(
    tmp_path: Path, sound, flip, name: str, seed: int, count: int
) -> None:
    fuzz(tmp_path / name, sound[name], flip, seed, count)


@pytest.mark.parametrize(("seed", "count"), [(0, SOME), many(1, ALL // PARTS)])
@pytest.mark.parametrize("name", ["run.jsonl", "run.mcap"])
def test_many_mutations_of_a_recording_are_no_tracebacks(
    tmp_path: Path, sound, mutate, name: str, seed: int, count: int
) -> None:
    fuzz(tmp_path / name, sound[name], mutate, seed, count)
