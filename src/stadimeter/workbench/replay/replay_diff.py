"""The difference between two sets of rules over one recording: events that come, go and move, figures of each rule."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from stadimeter.core.decision import Event
from stadimeter.workbench.replay.replay_figures import RuleFigures, Tally

SAME_WITHIN_S = 5.0
"""Two events of one kind and source that are further apart than this are different events."""

MOVED_S = 1e-9
"""Events that are nearer than this are at the same time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EventChange:
    """An event that is not the same with both sets of rules; it is of the new rules, unless it is lost.

    Attributes:
        by_s: The time by which it moved, positive for later; 0 if it did not move.
    """

    change: Literal["added", "lost", "moved"]
    event: Event
    by_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleChange:
    """The figures of a rule with both sets of rules; None where there is no such rule."""

    rule: str
    old: RuleFigures | None
    new: RuleFigures | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayDiff:
    """The difference that new rules make: changed events in order of time, and the figures of each rule."""

    changes: tuple[EventChange, ...]
    same: int
    rules: tuple[RuleChange, ...]
    minutes: float

    def record(self) -> dict[str, Any]:
        """Return the object that ``--json`` prints."""
        return {
            "minutes": self.minutes,
            "same_events": self.same,
            "changes": [asdict(change) for change in self.changes],
            "rules": [asdict(rule) for rule in self.rules],
        }


def compare(old: Tally, new: Tally) -> ReplayDiff:
    """Compare two replays of one recording."""
    changes: list[EventChange] = []
    same = 0
    old_events, new_events = _by_subject(old.events), _by_subject(new.events)
    for subject in {**old_events, **new_events}:
        for before, after in _paired(old_events[subject], new_events[subject]):
            change = _change(before, after)
            changes += [change] if change else []
            same += change is None
    changes.sort(key=lambda change: (change.event.at_s, change.event.sequence, change.change))
    return ReplayDiff(changes=tuple(changes), same=same, rules=_rules(old, new), minutes=new.minutes)


def _change(before: Event | None, after: Event | None) -> EventChange | None:
    if before is not None and after is not None:
        by_s = after.at_s - before.at_s
        return EventChange(change="moved", event=after, by_s=by_s) if abs(by_s) > MOVED_S else None
    if after is not None:
        return EventChange(change="added", event=after)
    return EventChange(change="lost", event=before) if before is not None else None


def _by_subject(events: Sequence[Event]) -> defaultdict[tuple[str, str], list[Event]]:
    found: defaultdict[tuple[str, str], list[Event]] = defaultdict(list)
    for event in events:
        found[event.kind.value, event.source].append(event)
    return found


def _paired(old: Sequence[Event], new: Sequence[Event]) -> list[tuple[Event | None, Event | None]]:
    """Pair events of one kind and source, in order of time: each with the nearest that is left for it."""
    # Both lists are sorted by time, so one pass does: the earlier of the two heads is paired, or is alone for good.
    pairs: list[tuple[Event | None, Event | None]] = []
    i = j = 0
    while i < len(old) and j < len(new):
        apart_s = new[j].at_s - old[i].at_s
        if abs(apart_s) <= SAME_WITHIN_S and not _has_nearer(old, new, i, j):
            pairs.append((old[i], new[j]))
            i, j = i + 1, j + 1
        elif apart_s > 0:
            pairs.append((old[i], None))
            i += 1
        else:
            pairs.append((None, new[j]))
            j += 1
    return [*pairs, *((event, None) for event in old[i:]), *((None, event) for event in new[j:])]


def _has_nearer(old: Sequence[Event], new: Sequence[Event], i: int, j: int) -> bool:
    """Return whether the later of two events is nearer to the one that follows the earlier."""
    apart_s = new[j].at_s - old[i].at_s
    if apart_s > 0:
        return i + 1 < len(old) and abs(new[j].at_s - old[i + 1].at_s) < apart_s
    return j + 1 < len(new) and abs(new[j + 1].at_s - old[i].at_s) < -apart_s


def _rules(old: Tally, new: Tally) -> tuple[RuleChange, ...]:
    before = {figures.rule: figures for figures in old.figures()}
    after = {figures.rule: figures for figures in new.figures()}
    return tuple(RuleChange(rule=name, old=before.get(name), new=after.get(name)) for name in {**after, **before})
