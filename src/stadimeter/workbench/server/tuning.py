"""An alarm that fired wrongly, mended on the page: a threshold dragged over recordings, or marks in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.server import editing
from stadimeter.workbench.server.operations import Desk, operation
from stadimeter.workbench.server.recordings import about, began_unix_s, recordings_of
from stadimeter.workbench.trial import KeptRecording
from stadimeter.workbench.tune import MOMENT_S, Proposal, Tuning, in_words, parse_mark, settings_of, with_settings

# Unless it is said otherwise, an answer comes at the latest after this time, with what is read by then.
FOR_S = 20.0

# The newest recordings that are looked at, and how much of one that is long before what is of interest.
NEWEST_MAX = 8
LONG_S = 600.0


@operation
def tune(
    desk: Desk,
    rule: str,
    changes: dict[str, float | str] | None = None,
    marks: list[str] | None = None,
    at_s: list[float] | None = None,
    for_s: float = FOR_S,
) -> dict[str, Any]:
    """Answer what an alarm with other settings would have done on recordings, beside what it does.

    With marks such as ``run.mcap@14.2s fire`` the best settings that meet them are answered. The recordings are those
    that hold moments, in seconds since 1970, and the newest. Reading them takes a while the first time: the answer
    comes after ``for_s`` with what there is by then; ``is_done`` says whether that is all. Marks wait for all.
    """
    tuning = tuning_of(desk, at_s or [])
    is_done = tuning.go_on(math.inf if marks else for_s)
    parsed = [parse_mark(each) for each in marks or ()]
    proposal = tuning.best(rule, parsed)[0] if marks else tuning.propose(rule, changes or {})
    return {"is_done": is_done, **answer_fields(tuning, rule, proposal)}


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
        base_version: The version of the configuration that the answer of `tune` was about.
    """
    tuning = tuning_of(desk, at_s or [])
    ours = with_settings(tuning.configuration, tuning.text, rule, changes)
    editing.refuse_if_changed(desk, base_version, ours)
    tuning.go_on(math.inf)
    files, tests = tuning.write(rule, changes, [parse_mark(each) for each in marks or ()])
    text = files.pop(desk.configuration.name)
    return {**editing.save(desk, text, files, base_version), "tests": tests}


def tuning_of(desk: Desk, moments_s: Sequence[float]) -> Tuning:
    """Return the tuning kept for the configuration as it is saved: recordings of these moments, and the newest."""
    text = editing.saved_text(desk) or ""
    tuning, asked_s = desk.remember(
        "tuning", text, lambda: (Tuning(configuration=load_configuration(desk.configuration), text=text), set[float]())
    )
    missing = (at_s for at_s in moments_s if at_s not in asked_s)  # what no recording holds is looked for once
    if not tuning.recordings or not all(
        any(_holds(each, at_s) for each in tuning.recordings.values()) for at_s in missing
    ):
        _choose_recordings(desk, tuning, sorted(moments_s))
        asked_s.clear()
    asked_s.update(moments_s)
    return tuning


def _choose_recordings(desk: Desk, tuning: Tuning, moments_s: Sequence[float]) -> None:
    """Take those that hold moments from some time before the first one on, and the ends of the newest."""
    found = recordings_of(desk)
    told = {name: each for name, path in found.items() if (each := about(desk, path))["seconds"]}
    told = {name: each for name, each in told.items() if not any(_is_within(each, other) for other in told.values())}
    wanted = [
        (name, since_s)
        for at_s in moments_s
        for name, each in told.items()
        if 0 <= (since_s := at_s - each["unix_s"]) <= each["seconds"]
    ]
    newest = sorted(told, key=lambda name: told[name]["unix_s"], reverse=True)[:NEWEST_MAX]
    tuning.recordings.clear()
    for name, since_s in [*wanted, *((name, told[name]["seconds"]) for name in newest)]:
        if name not in tuning.recordings:
            tuning.add(name, found[name], max(0.0, since_s - LONG_S))


def _is_within(told: dict[str, Any], other: dict[str, Any]) -> bool:
    """Check whether another recording holds all of one, such as a clip of the last hour: its alarms count once."""
    begins_s: float = told["unix_s"] - other["unix_s"]
    ends_s, slack_s = begins_s + told["seconds"], MOMENT_S
    return bool(told["seconds"] < other["seconds"] and begins_s >= -slack_s and ends_s <= other["seconds"] + slack_s)


def _holds(kept: KeptRecording, at_s: float) -> bool:
    since_s = at_s - began_unix_s(kept.recording.header, math.inf)
    return kept.from_s <= since_s and (not kept.is_done or since_s <= kept.seconds)


def answer_fields(tuning: Tuning, rule: str, proposal: Proposal) -> dict[str, Any]:
    """Return the result of settings as JSON has it."""
    settings = settings_of(tuning.configuration, rule)
    return {
        "version": editing.version_of(tuning.text),
        "settings": {key: {"value": each.value, "unit": each.unit} for key, each in settings.items()},
        "changes": dict(proposal.values),
        "words": in_words(rule, proposal.answers),
        "recordings": [
            {
                "name": each.name,
                "began_unix_s": began_unix_s(each.kept.recording.header, 0.0),
                "from_s": each.kept.from_s,
                "to_s": each.kept.seconds,
                "damage": each.kept.damage,
                "before": each.before,
                "after": each.spans,
            }
            for each in proposal.answers
        ],
    }
