"""An alarm that fired wrongly, mended on the page: a threshold dragged over recordings, or marks in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stadimeter.app.control.recording import LAST
from stadimeter.config.loader import load_configuration
from stadimeter.workbench.replay.what_if import KeptRecording
from stadimeter.workbench.rule_settings import alarm_named, settings_of, with_settings
from stadimeter.workbench.server import editing
from stadimeter.workbench.server.operations import Desk, operation
from stadimeter.workbench.server.recordings import ENDINGS, about, began_unix_s
from stadimeter.workbench.server.run_of_desk import folder_of
from stadimeter.workbench.teaching.lesson import Answer, Lesson, in_words
from stadimeter.workbench.teaching.search import parse_mark

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
    base_version: str = "",
) -> dict[str, Any]:
    """Save other settings of an alarm, with rule tests that hold the marks, or else what comes and goes.

    Args:
        base_version: The version of the configuration that the answer of `what_if` or `teach` was about.
    """
    lesson = lesson_of(desk, at_s or [])
    ours = with_settings(lesson.configuration, lesson.text, rule, changes)
    editing.refuse_if_changed(desk, base_version, ours)
    lesson.go_on(math.inf)
    text, tests = lesson.write(rule, changes, [parse_mark(each) for each in marks or ()])
    return {**editing.save(desk, text, None, base_version), "tests": tests}


def lesson_of(desk: Desk, moments_s: Sequence[float]) -> Lesson:
    """Return the lesson kept for the configuration as it is saved: recordings of these moments, and the newest.

    It takes up to 90 MB, so it is freed when nothing was asked for a while.
    """
    text = editing.saved_text(desk) or ""
    if "lesson" not in desk.kept:
        desk.at_rest.append(lambda: desk.kept.update(lesson=None))
    kept: tuple[str, Lesson, set[float]] | None = desk.kept.get("lesson")
    if kept is None or kept[0] != text:
        kept = text, Lesson(configuration=load_configuration(desk.configuration), text=text), set()
        desk.kept["lesson"] = kept
    _, lesson, asked_s = kept
    missing = (at_s for at_s in moments_s if at_s not in asked_s)  # what no recording holds is looked for once
    if not lesson.recordings or not all(
        any(_holds(each, at_s) for each in lesson.recordings.values()) for at_s in missing
    ):
        _choose_recordings(desk, lesson, sorted(moments_s))
        asked_s.clear()
    asked_s.update(moments_s)
    return lesson


def _choose_recordings(desk: Desk, lesson: Lesson, moments_s: Sequence[float]) -> None:
    """Let a lesson have those that hold moments from some time before the first one on, and the ends of the newest."""
    found = recordings_of(desk)
    told = {name: each for name, path in found.items() if (each := about(desk, path))["seconds"]}
    wanted = [
        (name, since_s)
        for at_s in moments_s
        for name, each in told.items()
        if 0 <= (since_s := at_s - each["unix_s"]) <= each["seconds"]
    ]
    newest = sorted(told, key=lambda name: told[name]["unix_s"], reverse=True)[:NEWEST_MAX]
    lesson.recordings.clear()
    for name, since_s in [*wanted, *((name, told[name]["seconds"]) for name in newest)]:
        if name not in lesson.recordings:
            lesson.add(name, found[name], max(0.0, since_s - LONG_S))


def _holds(kept: KeptRecording, at_s: float) -> bool:
    since_s = at_s - began_unix_s(kept.recording.header, math.inf)
    return kept.from_s <= since_s and (not kept.is_done or since_s <= kept.seconds)


def recordings_of(desk: Desk) -> dict[str, Path]:
    """Return every recording of the run by its name below the folder: its own, clips, and the last hour."""
    folder = folder_of(desk)
    inside = (folder, folder / "clips", folder / LAST / desk.configuration.stem)
    paths = (path for each in inside for path in each.glob("*") if path.suffix in ENDINGS and path.is_file())
    return {path.relative_to(folder).as_posix(): path for path in paths}


def answer_fields(lesson: Lesson, rule: str, answers: Sequence[Answer]) -> dict[str, Any]:
    """Return answers as JSON has them."""
    _, alarm = alarm_named(lesson.configuration, rule)
    settings = settings_of(lesson.configuration, rule)
    return {
        "version": editing.version_of(lesson.text),
        "settings": {key: {"value": each.value, "unit": each.unit} for key, each in settings.items()},
        "words": in_words(alarm.name, answers),
        "recordings": [
            {
                "name": each.name,
                "began_unix_s": began_unix_s(each.kept.recording.header, 0.0),
                "from_s": each.kept.from_s,
                "to_s": each.kept.seconds,
                "damage": each.kept.damage,
                "before": each.kept.side.rules[alarm.name].spans,
                "after": each.after.rules[alarm.name].spans,
            }
            for each in answers
        ],
    }
