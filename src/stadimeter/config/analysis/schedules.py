"""Schedules that cannot be judged or never come, what becomes of them when clocks are changed, and orders of rules."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from datetime import UTC, date, datetime, timedelta, tzinfo
from itertools import pairwise

from stadimeter.config.analysis import Subject
from stadimeter.config.extras import missing
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import WrittenCondition
from stadimeter.core.conditions.discrete import ScheduleCondition
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.words import time_of_day

# Clocks are changed twice a year at most, on the same days nearly: a year ahead shows both.
_AHEAD_DAYS = 366


def schedule_errors(subject: Subject) -> Iterator[Finding]:
    """Find schedules by the sun of no place, and rules in an order in which they cannot be raised."""
    for written, leaf in _leaves(subject):
        if isinstance(leaf, ScheduleCondition) and (leaf.from_sun or leaf.to_sun):
            yield from _without_sun(subject, written)
        if isinstance(leaf, SequenceCondition):
            yield from _order(subject, written, leaf)


def schedule_warnings(subject: Subject) -> Iterator[Finding]:
    """Find schedules that are over or never come, and that begin or end while the clocks are changed."""
    zone = subject.draft.place.zone if subject.draft.place is not None else None
    changes: list[tuple[datetime, datetime]] | None = None
    for written, leaf in _leaves(subject):
        if not isinstance(leaf, ScheduleCondition):
            continue
        yield from _never_comes(written, leaf)
        if changes is None:
            changes = list(_changes(zone, datetime.now(UTC)))
        yield from _while_changed(written, leaf, changes)


def _leaves(subject: Subject) -> Iterator[tuple[WrittenCondition, object]]:
    for declared in subject.rules:
        for condition in declared.conditions():
            for written in condition.leaves():
                yield written, written.leaf


def _without_sun(subject: Subject, written: WrittenCondition) -> Iterator[Finding]:
    at, place = (*written.limits_path, "between"), subject.draft.place
    if trouble := missing("sun"):
        yield Finding(at, f"when the sun rises and sets is not known here: {trouble}", "", "library-missing")
    if place is None or place.latitude is None:
        hint = "add a section [place] with latitude and longitude, in degrees"
        yield Finding(at, "where the sun rises and sets is not said", hint, "place-missing")


def _order(subject: Subject, written: WrittenCondition, leaf: SequenceCondition) -> Iterator[Finding]:
    at = (*written.path, "sequence_of", "rules")
    twice = [name for name, times in Counter(leaf.rules).items() if times > 1]
    if twice:
        message = f"'{twice[0]}' is named twice, and only when it was raised last is known"
        yield Finding(at, message, "name each rule once; for how often it comes write another condition", "order-twice")
    several = {each.section: each for each in subject.rules if "targets" in each.table}
    for name in (name for name in leaf.rules if name in several):
        members = [f"'{each.rule.name}'" for each in subject.every_rule if each.section == name]
        message = f"'{name}' stands for several rules: {', '.join(members)}"
        yield Finding(at, message, "name one of them", "order-of-several")


def _never_comes(written: WrittenCondition, leaf: ScheduleCondition) -> Iterator[Finding]:
    at = (*written.limits_path, "dates")
    if not leaf.dates or any(len(span.first) == 2 for span in leaf.dates):
        return
    if all(date(*span.last) < date.today() - timedelta(days=1) for span in leaf.dates):  # noqa: DTZ011 - of the place, nearly
        message = f"the last of these days was {max(date(*span.last) for span in leaf.dates)}: it does not come again"
        yield Finding(at, message, "write month and day alone for every year, or remove the rule", "schedule-over")
    days = (date(*span.first) + timedelta(days=number) for span in leaf.dates for number in range(7))
    begin = [day for day in days if any(span.covers(day) for span in leaf.dates)]
    if leaf.weekdays and not any(day.weekday() in leaf.weekdays for day in begin):
        yield Finding(at, "none of these dates is on one of its days", "change dates or days", "never-true")


def _changes(zone: tzinfo | None, now: datetime) -> Iterator[tuple[datetime, datetime]]:
    """Yield what clocks show just before they are changed, and just after, for the year ahead."""
    days = [now + timedelta(days=number) for number in range(_AHEAD_DAYS)]
    for before, after in pairwise(days):
        if before.astimezone(zone).utcoffset() == after.astimezone(zone).utcoffset():
            continue
        low, high = before, after
        while high - low > timedelta(seconds=1):
            middle = low + (high - low) / 2
            is_before = middle.astimezone(zone).utcoffset() == before.astimezone(zone).utcoffset()
            low, high = (middle, high) if is_before else (low, middle)
        turn = high.replace(second=0, microsecond=0)  # clocks are changed at whole minutes
        shown = turn.astimezone(zone)
        was = (turn - timedelta(seconds=1)).astimezone(zone) + timedelta(seconds=1)
        yield was.replace(tzinfo=None), shown.replace(tzinfo=None)


def _while_changed(
    written: WrittenCondition, leaf: ScheduleCondition, changes: list[tuple[datetime, datetime]]
) -> Iterator[Finding]:
    ends = [
        (what, second)
        for what, sun, second in (("begins", leaf.from_sun, leaf.from_s), ("ends", leaf.to_sun, leaf.to_s))
        if not sun
    ]
    at = [change for change in changes if any(leaf.begins_on(change[0].date() - timedelta(days=by)) for by in (0, 1))]
    said = [each for was, shown in at for what, second in ends if (each := _at_change(what, second, was, shown))]
    if said:
        hint = "choose another time if that matters"
        yield Finding((*written.limits_path, "between"), "; ".join(said), hint, "clocks-changed")


def _at_change(what: str, second: float, was: datetime, shown: datetime) -> str:
    """Say what becomes of a time of the day when clocks go from one time to another; empty for nothing."""
    low, high = sorted((was, shown))
    at = datetime.combine(low, datetime.min.time()) + timedelta(seconds=second)
    if not low < at < high:
        return ""
    turned = f"on {was.date()} clocks go from {was:%H:%M} to {shown:%H:%M}"
    if shown > was:
        return f"{turned}: {time_of_day(second)} does not come, and it {what} at {shown:%H:%M}"
    return f"{turned}: {time_of_day(second)} comes twice, and it {what} twice"
