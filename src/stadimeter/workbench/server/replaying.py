"""The effect that an edited configuration would have had on a recording, beside what was done."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from stadimeter.app.live.snapshot import RunSnapshot
from stadimeter.core.words import duration
from stadimeter.workbench.replay import ReplayRun, read_recording, replay_run
from stadimeter.workbench.server.editing import load_text
from stadimeter.workbench.server.operations import Desk, operation
from stadimeter.workbench.server.recordings import about, path_of
from stadimeter.workbench.trial import CYCLES_MAX, EventChange, RuleChange, SideBySide, Span, TrialDiff, compare

# Unless it is said otherwise, an answer comes at the latest after this time.
FOR_S = 20.0

# Comparisons that go on beside each other: of several tabs, each would begin that of the other anew.
FOR_MAX_S = 60.0
CHANGES_MAX = 40
KEPT_MAX = 3


@operation
def replay_diff(
    desk: Desk, name: str, text: str, files: dict[str, str] | None = None, for_s: float = FOR_S
) -> dict[str, Any]:
    """Answer what a text would have done on a recording, beside what was decided then.

    A long recording takes a while. The answer comes after ``for_s`` with what there is by then; the same question again
    goes on from there. ``progress`` is 1 when it is at its end.
    """
    path = path_of(desk, name)
    side_by_side = _find_comparison(desk, path, text, files or {})
    if not side_by_side.is_done:
        side_by_side.go_on(min(FOR_MAX_S, max(0.05, for_s)))
    return _comparison_fields(side_by_side, about(desk, path))


def _find_comparison(desk: Desk, path: Path, wanted: str, files: Mapping[str, str]) -> SideBySide:
    """Return the comparison that was asked for before, as far as it got, or a new one.

    A recording that grows while it is compared is no other one, or there would be no end.
    """
    about_file = path.stat()
    asked, size = (str(path), about_file.st_ino, wanted, tuple(files.items())), about_file.st_size
    kept: dict[Any, tuple[SideBySide, int]] = desk.kept.setdefault("replay-diff", {})
    found = kept.pop(asked, None)
    if found is None or (found[0].is_done and found[1] != size):
        after = ReplayRun(recording := read_recording(path), load_text(desk, wanted, dict(files)))
        found = SideBySide(replay_run(recording, None), after), size
    kept[asked] = found
    while len(kept) > KEPT_MAX:
        del kept[next(iter(kept))]
    return found[0]


def _comparison_fields(found: SideBySide, recording: Mapping[str, Any]) -> dict[str, Any]:
    plan, seconds, difference = found.after.configuration.plan, found.new.seconds, compare(found.old, found.new)
    limits = sorted({limit_m for each in RunSnapshot(plan=plan).limits_m.values() for limit_m in each})
    whole_s = max(recording["seconds"] or 0.0, seconds)
    return {
        "from_s": 0.0,
        "to_s": seconds,
        "seconds": whole_s,
        "progress": 1.0 if found.is_done else round(min(0.99, seconds / whole_s if whole_s else 0.0), 3),
        "samples": {name: found.new.points(name) for name in found.new.samples},
        "thresholds_m": limits,
        "lanes": [
            {"rule": rule, "before": _spans(found.old.spans(rule)), "after": _spans(found.new.spans(rule))}
            for rule in {**found.new.traces, **found.old.traces}
        ],
        "words": list(_words(found, difference, recording)),
        "differences": [_change(each, found.new.began_s) for each in difference.changes[:CHANGES_MAX]],
    }


def _spans(spans: list[Span]) -> list[dict[str, float]]:
    return [{"from_s": round(from_s, 3), "to_s": round(to_s, 3)} for from_s, to_s in spans]


def _words(found: SideBySide, difference: TrialDiff, recording: Mapping[str, Any]) -> Iterator[str]:
    if not found.is_done:
        yield f"So far only the first {duration(found.new.seconds)} are compared."
    elif found.new.cycles >= CYCLES_MAX:
        yield f"Only the first {duration(found.new.seconds)} are compared: it is a long recording."
    if damage := found.damage or recording["damage"]:
        yield f"The recording is damaged: {damage}."
    missing = [name for name in found.after.configuration.plan.targets if name not in found.targets]
    if missing:
        yield f"Nothing is known of {', '.join(missing)}: it was not looked for when this was recorded."
    yield difference.summary() if difference.changes else "Every event is the same."
    for rule in difference.rules:
        yield from _rule_words(rule)


def _rule_words(rule: RuleChange) -> Iterator[str]:
    if rule.old is None or rule.new is None:
        figures = rule.new or rule.old
        what = "is new" if rule.new else "is gone"
        yield f"{rule.rule} {what}: raised {_times(figures.raised if figures else 0)}."
    elif rule.old.raised != rule.new.raised:
        yield f"{rule.rule}: raised {_times(rule.new.raised)}, it was {_times(rule.old.raised)}."


def _times(count: int) -> str:
    return {0: "never", 1: "once", 2: "twice"}.get(count, f"{count} times")


def _change(change: EventChange, began_s: float) -> dict[str, Any]:
    event = change.event
    return {
        "change": change.change,
        "by_s": round(change.by_s, 3),
        "at_s": round(event.at_s - began_s, 3),
        "kind": event.kind.value,
        "source": event.source,
        "reason": event.reason,
    }
