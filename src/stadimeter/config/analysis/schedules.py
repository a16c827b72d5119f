"""Schedules by an unknown sun, or at a time that clocks skip or show twice; rules in an order that never is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from datetime import datetime, timedelta, tzinfo
from itertools import pairwise

from stadimeter.config.analysis import Subject
from stadimeter.config.extras import missing
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import WrittenCondition
from stadimeter.core.conditions.discrete import ScheduleCondition
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.observation import MonthDay
from stadimeter.core.words import time_of_day

# Clocks are changed in every year on nearly the same days.
_AHEAD_DAYS = 366


def schedule_errors(subject: Subject) -> Iterator[Finding]:
    """Find schedules by the sun of no place, and rules in an order in which they cannot be raised."""
    place = subject.draft.place
    for written in _leaves(subject):
        leaf, at = written.leaf, (*written.limits_path, "between")
        if isinstance(leaf, SequenceCondition):
            yield from _order(subject, written, leaf)
        if not isinstance(leaf, ScheduleCondition) or not leaf.is_by_sun:
            continue
        if place is None or place.latitude is None or place.longitude is None:
            hint = "add a section [place] with latitude and longitude, in degrees"
            yield Finding(at, "where the sun rises and sets is not said", hint, "place-missing")
        if trouble := missing("sun"):
            yield Finding(at, f"when the sun rises and sets cannot be computed: {trouble}", "", "library-missing")


def schedule_warnings(subject: Subject) -> Iterator[Finding]:
    """Find schedules that begin or end at a time that clocks skip, or show twice, when they are changed."""
    schedules = [(written, leaf) for written in _leaves(subject) if isinstance(leaf := written.leaf, ScheduleCondition)]
    if schedules:
        zone = subject.draft.place.zone if subject.draft.place is not None else None
        days = _days_of_change(zone)
        for written, leaf in schedules:
            ends = (("begins", leaf.from_sun, leaf.from_s), ("ends", leaf.to_sun, leaf.to_s))
            said = [words for does, sun, at_s in ends if not sun for words in _at_change(leaf, does, at_s, zone, days)]
            if said:
                hint = "choose another time if that matters"
                yield Finding((*written.limits_path, "between"), "; ".join(said), hint, "clocks-changed")


def _leaves(subject: Subject) -> Iterator[WrittenCondition]:
    return (leaf for declared in subject.rules for condition in declared.conditions() for leaf in condition.leaves())


def _order(subject: Subject, written: WrittenCondition, leaf: SequenceCondition) -> Iterator[Finding]:
    at = (*written.path, "sequence_of", "rules")
    several = {each.section for each in subject.rules if "targets" in each.table}
    for name, times in Counter(leaf.rules).items():
        if times > 1:
            message = f"'{name}' is named twice, and only when it was raised last counts"
            yield Finding(at, message, "name each rule once", "order-twice")
        if name in several:
            members = ", ".join(f"'{each.rule.name}'" for each in subject.every_rule if each.section == name)
            yield Finding(at, f"'{name}' stands for several rules: {members}", "name one of them", "order-of-several")


def _days_of_change(zone: tzinfo | None) -> list[datetime]:
    """Return the days of the year ahead, as their midnights, on which clocks are changed."""
    today = datetime.combine(datetime.now(zone), datetime.min.time())
    days = [today + timedelta(days=number) for number in range(_AHEAD_DAYS + 1)]
    return [day for day, after in pairwise(days) if _offsets_s(day, zone) != _offsets_s(after, zone)]


def _at_change(
    leaf: ScheduleCondition, does: str, at_s: float, zone: tzinfo | None, days: list[datetime]
) -> Iterator[str]:
    """Say what becomes of one end of a schedule when clocks are changed."""
    for day in days:
        first_s, second_s = _offsets_s(day + timedelta(seconds=at_s), zone)
        # Both a moment before and then: at the beginning of what is skipped, or comes twice, nothing is odd.
        before_s = _offsets_s(day + timedelta(seconds=at_s - 1), zone)
        if first_s == second_s or before_s != (first_s, second_s):
            continue
        begins = [day - timedelta(days=by) for by in (0, 1)]
        if any(
            leaf.begins_on(MonthDay(each.month, each.day)) and each.weekday() in (leaf.weekdays or range(7))
            for each in begins
        ):
            what = f"on {day.date()}, when clocks are changed, {time_of_day(at_s)}"
            once = f"does not come: it {does} when they have been"
            yield f"{what} {once if first_s < second_s else f'comes twice, and it {does} twice'}"


def _offsets_s(shown: datetime, zone: tzinfo | None) -> tuple[float, ...]:
    """Return how far what clocks show is from universal time: the two differ where it is skipped, or comes twice."""
    at = (shown.replace(tzinfo=zone, fold=fold).astimezone(zone) for fold in (0, 1))
    return tuple((each.utcoffset() or timedelta()).total_seconds() for each in at)
