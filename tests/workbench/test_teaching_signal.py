"""The quick signal of a recording fires when the rules do, and marks that a rule meets are met."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter
from stadimeter.app.recordings.recorded_configuration import to_be_recorded
from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.decision import Decision
from stadimeter.core.observation import Observation
from stadimeter.errors import ConfigError
from stadimeter.workbench.teaching.lesson import Lesson
from stadimeter.workbench.teaching.marks import FiringMark
from support.observing import Rehearsal
from support.saves import LENS

TEXT = """
[camera]
driver = "simulated"
model = "camera.toml"
[targets.ball]
detector = "ideal"
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
[rules.near]
when = {{ below = "{below} m", deadband = "{deadband} m" }}
on_delay = "{on_delay} s"
off_delay = "{off_delay} s"
"""
NAME = "run.jsonl"
VISITS = [(0.8, 90), (1.4, 60), (0.6, 20), (1.1, 120), (0.9, 45)]
"""How near, and for how many frames: the ball is there at once, so the tracker refuses the first frames of it."""
HIDDEN = {"below": 1.25, "on_delay": 1.0, "off_delay": 0.5, "deadband": 0.1}


def load(folder: Path, **settings: float) -> Configuration:
    (folder / "camera.toml").write_text(camera_file_text(LENS))
    place = folder / "stadimeter.toml"
    return load_configuration(place, texts={place: TEXT.format(**settings)})


def lesson_of(folder: Path, **settings: float) -> Lesson:
    """Return a lesson on a rule with these settings, with the recording of the visits."""
    configuration = load(folder, **settings)
    writer = JournalWriter(folder / NAME, to_be_recorded(configuration))

    class Recorded(Rehearsal):
        def cycle(self, observation: Observation) -> Decision:
            decision = super().cycle(observation)
            writer.write(CycleRecord(observation=observation, decision=decision, applied=(), timings_s={}))
            return decision

    rehearsal = Recorded(configuration.plan)
    for nearest_m, frames in VISITS:
        rehearsal.see(*[3.0] * 60, *[nearest_m] * frames, *[3.0] * 60)
    writer.close()
    lesson = Lesson(configuration=configuration, text=TEXT.format(**settings))
    lesson.add(NAME, folder / NAME)
    lesson.go_on(math.inf)
    return lesson


@pytest.mark.long
@pytest.mark.parametrize("own", [{"below": 0.7}, {"off_delay": 20.0, "deadband": 1.0}], ids=str)
def test_marks_that_some_rule_meets_are_never_refused(tmp_path, own):
    lesson = lesson_of(tmp_path, **{**HIDDEN, **own})
    kept = lesson.recordings[NAME]
    hidden = kept.decide_with(load(tmp_path, **HIDDEN).plan).rules["near"].spans
    marks = [FiringMark(recording=NAME, from_s=at - 0.5, to_s=at + 0.5, should_fire=True) for at, _ in hidden]
    marks += [
        FiringMark(recording=NAME, from_s=begin, to_s=begin, should_fire=False)
        for begin, end in kept.side.rules["near"].spans
        if not any(begin - 1 <= last and first <= end + 1 for first, last in hidden)
    ]
    found = lesson.propose("near", marks)
    assert [begin for begin, _ in found.answers[0].after.rules["near"].spans] == pytest.approx(
        [begin for begin, _ in hidden], abs=0.5
    )


def test_two_opposite_marks_are_refused_and_both_are_named(tmp_path):
    lesson = lesson_of(tmp_path, **HIDDEN)
    begin, end = lesson.recordings[NAME].side.rules["near"].spans[0]
    mark = FiringMark(recording=NAME, from_s=begin - 0.5, to_s=end, should_fire=True)
    against = replace(mark, should_fire=False)
    with pytest.raises(ConfigError) as refused:
        lesson.propose("near", [mark, against])
    assert f"'{mark.words}' and '{against.words}' contradict each other" in str(refused.value)
