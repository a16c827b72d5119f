"""An alarm that fired wrongly, mended on the page: a threshold dragged over recordings, or marks in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stadimeter.app.control.last_recording import FOLDER as LAST
from stadimeter.config.loader import load_configuration
from stadimeter.workbench.replay.what_if import KeptRecording
from stadimeter.workbench.rule_settings import alarm_named
from stadimeter.workbench.server import editing
from stadimeter.workbench.server.operations import Desk, operation
from stadimeter.workbench.server.recordings import ENDINGS, about, began_unix_s
from stadimeter.workbench.server.run_of_desk import folder_of
from stadimeter.workbench.teaching.lesson import Answer, Lesson, in_words
from stadimeter.workbench.teaching.marks import parse_mark

# Unless it is said otherwise, an answer comes at the latest after this time, with what is read by then.
FOR_S = 20.0

# The newest recordings that are looked at, and how much of one that is long before what is of interest.
NEWEST_MAX = 8
LONG_S = 600.0


@operation
def what_if(
    desk: Desk,
    rule: str,
    changes: dict[str, float | str] | None = None,
    at_s: list[float] | None = None,
    for_s: float = FOR_S,
) -> dict[str, Any]:
    """Answer what an alarm with other settings would have done on recordings, beside what it does.

    They are those that hold moments, in seconds since 1970, and the newest. Reading them takes a while the first time:
    the answer comes after ``for_s`` with what there is by then; ``is_done`` says whether that is all.
    """
    lesson = lesson_of(desk, at_s or [])
    is_done = lesson.go_on(for_s)
    answers = lesson.answer(lesson.load(rule, changes or {}).plan)
    return {"is_done": is_done, **answer_fields(lesson, rule, answers)}


@operation
def teach(desk: Desk, rule: str, marks: list[str], at_s: list[float] | None = None) -> dict[str, Any]:
    """Answer the smallest change of an alarm that meets marks such as ``run.mcap@14.2s fire``."""
    lesson = lesson_of(desk, at_s or [])
    lesson.go_on(math.inf)
    found = lesson.propose(rule, [parse_mark(each) for each in marks])
    return {"changes": dict(found.values), **answer_fields(lesson, rule, found.answers)}


@operation
def save(
    desk: Desk,
    rule: str,
    changes: dict[str, float | str],
    marks: list[str] | None = None,
    at_s: list[float] | None = None,
    base_version: str | None = None,
) -> dict[str, Any]:
    """Save other settings of an alarm, with a rule test that holds the marks, or else what comes and goes."""
    lesson = lesson_of(desk, at_s or [])
    lesson.go_on(math.inf)
    text, tests = lesson.write(rule, changes, [parse_mark(each) for each in marks or ()])
    saved = editing.save(desk, text, None, editing.version_of(lesson.text) if base_version is None else base_version)
    return {
        **saved,
        "tests": [each for each in editing.check(desk, text, tests=True)["tests"] if each["name"] in tests],
    }


def lesson_of(desk: Desk, moments_s: Sequence[float]) -> Lesson:
    """Return what is kept for the configuration as it is saved: recordings of these moments, and the newest."""
    text = editing.saved_text(desk) or ""
    kept: tuple[str, Lesson] | None = desk.kept.get("lesson")
    if kept is None or kept[0] != text:
        kept = text, Lesson(configuration=load_configuration(desk.configuration), text=text)
        desk.kept["lesson"] = kept
    lesson = kept[1]
    if lesson.recordings and all(any(_holds(each, at_s) for each in lesson.recordings.values()) for at_s in moments_s):
        return lesson
    found = recordings_of(desk)
    newest = sorted(found, key=lambda name: found[name].stat().st_mtime, reverse=True)[:NEWEST_MAX]
    lesson.recordings.clear()
    for at_s in moments_s:
        for name, path in found.items():
            told = about(desk, path)
            if told["unix_s"] <= at_s <= told["unix_s"] + (told["seconds"] or 0.0):
                lesson.add(name, path, max(0.0, at_s - told["unix_s"] - LONG_S))
    for name in newest:
        told = about(desk, found[name])
        if name not in lesson.recordings and told["seconds"]:
            lesson.add(name, found[name], max(0.0, told["seconds"] - LONG_S))
    return lesson


def _holds(kept: KeptRecording, at_s: float) -> bool:
    began_s = began_unix_s(kept.recording.header, math.inf)
    return began_s + kept.from_s <= at_s and (not kept.is_done or at_s <= began_s + kept.seconds)


def recordings_of(desk: Desk) -> dict[str, Path]:
    """Return every recording of the run by its name below the folder: its own, clips, and the last hour."""
    folder = folder_of(desk)
    inside = (folder, folder / "clips", folder / LAST / desk.configuration.stem)
    paths = (path for each in inside for path in each.glob("*") if path.suffix in ENDINGS and path.is_file())
    return {path.relative_to(folder).as_posix(): path for path in paths}


def answer_fields(lesson: Lesson, rule: str, answers: Sequence[Answer]) -> dict[str, Any]:
    """Return answers as JSON has them."""
    _, alarm = alarm_named(lesson.configuration, rule)
    return {
        "settings": {key: {"value": each.value, "unit": each.unit} for key, each in lesson.settings(rule).items()},
        "words": in_words(alarm.name, answers),
        "recordings": [
            {
                "name": each.name,
                "began_unix_s": began_unix_s(each.kept.recording.header, 0.0),
                "from_s": each.kept.from_s,
                "to_s": each.kept.seconds,
                "damage": each.kept.damage,
                "before": each.kept.side.rules[alarm.name].thinned(),
                "after": each.after.rules[alarm.name].thinned(),
            }
            for each in answers
        ],
    }
