"""Schedules by an unknown sun, or at a time that clocks skip or show twice; rules in an order that never is."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from datetime import datetime, timedelta, tzinfo
from itertools import pairwise

from msgspec.structs import replace

from stadimeter.config.analysis import Subject
from stadimeter.config.extras import missing
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import WrittenCondition
from stadimeter.config.sun import HORIZON_DEG, sun_times_s
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.of_rules import SequenceCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.rule import ReportRule
from stadimeter.core.words import time_of_day

# Clocks are changed in every year on nearly the same days.
_AHEAD_DAYS = 366

# A message at a time of day, on every day; and a year that has every date.
_EVERY_DAY = ScheduleCondition(from_s=0.0, to_s=0.0)
_YEAR = datetime(2000, 1, 1)  # noqa: DTZ001 - its dates count

# The largest declination of the sun.
_TROPIC_DEG = 23.44

# Nearer to a pole than a degree, the sun can rise or set on no more days of a year than this.
_FEW_DAYS = 12


def schedule_errors(subject: Subject) -> Iterator[Finding]:
    """Find schedules by the sun of no place, and rules in an order in which they cannot be raised."""
    place = subject.draft.place
    for written in subject.leaves:
        leaf, at = written.leaf, (*written.limits_path, "between")
        if isinstance(leaf, SequenceCondition):
            yield from _order(subject, written, leaf)
        if not isinstance(leaf, ScheduleCondition) or not leaf.is_by_sun:
            continue
        if place is None or place.latitude is None or place.longitude is None:
            hint = "add a section [place] with latitude and longitude, in degrees"
            yield Finding(at, "where the sun rises and sets is not said", hint, "place-missing")
        elif not _comes(leaf, place.latitude):
            message = (
                f"at latitude {place.latitude:g}, the sun neither rises nor sets on any of its days: it never holds"
            )
            yield Finding(at, message, "write hours in place of sunrise and sunset, or other dates", "never-true")
        elif sum(_polar_sun_s(place.latitude, number) is None for number in range(_AHEAD_DAYS)) < _FEW_DAYS:
            message = f"at latitude {place.latitude:g}, the sun rises and sets once a year, not once a day"
            yield Finding(at, message, "write hours in place of sunrise and sunset", "sun-at-pole")
        if trouble := missing("sun"):
            yield Finding(at, f"when the sun rises and sets cannot be computed: {trouble}", "", "library-missing")


def schedule_warnings(subject: Subject) -> Iterator[Finding]:
    """Find schedules and messages at a time that clocks skip, or show twice, when they are changed."""
    ends: list[tuple[KeyPath, ScheduleCondition, str, str, float]] = []
    for written in subject.leaves:
        if isinstance(leaf := written.leaf, ScheduleCondition):
            at = (*written.limits_path, "between")
            both = (("begins", leaf.from_sun, leaf.from_s), ("ends", leaf.to_sun, leaf.to_s))
            ends += [(at, leaf, does, f"{does} when they have been", at_s) for does, sun, at_s in both if not sun]
    for each in subject.rules:
        if isinstance(rule := each.rule, ReportRule):
            ends += [(each.at("at"), _EVERY_DAY, "sends", "sends nothing", at_s) for at_s in rule.at_seconds]
    yield from _empty_days(subject)
    if ends:
        zone = subject.draft.place.zone if subject.draft.place is not None else None
        days, said = _days_of_change(zone), defaultdict[KeyPath, list[str]](list)
        for at, leaf, does, if_skipped, at_s in ends:
            said[at] += _at_change(leaf, does, if_skipped, at_s, zone, days)
        hint = "choose another time if that matters"
        yield from (Finding(at, "; ".join(words), hint, "clocks-changed") for at, words in said.items() if words)


def _empty_days(subject: Subject) -> Iterator[Finding]:
    """Name the days of the year ahead on which schedules by the sun are empty."""
    place = subject.draft.place
    if place is None or place.latitude is None or place.longitude is None:
        return
    for written in subject.leaves:
        if not isinstance(leaf := written.leaf, ScheduleCondition) or not leaf.is_by_sun:
            continue
        days, empty = [], []
        for day in _days_ahead(place.zone):
            if leaf.begins_on(MonthDay(day.month, day.day)):
                days.append(day)
                rises_s, sets_s = sun_times_s(place.latitude, place.longitude, place.zone, day.date())
                wall = WallTime(second_of_day=0.0, weekday=0, sunrise_s=rises_s, sunset_s=sets_s)
                low_s, high_s = leaf.interval_s(wall) or (0.0, 0.0)
                empty += [] if low_s < high_s else [day]
        if empty:
            message = f"it is empty on {len(empty)} of the next {len(days)} days on which it may hold: {_spans(empty)}"
            hint = "its end comes first then; write another time if it shall hold on these days too"
            yield Finding((*written.limits_path, "between"), message, hint, "empty-days")


def _spans(days: list[datetime]) -> str:
    """Return days in order as spans, such as ``06-08 to 07-03``."""
    firsts = [day for at, day in enumerate(days) if not at or day - days[at - 1] > timedelta(days=1)]
    lasts = [day for at, day in enumerate(days) if at + 1 == len(days) or days[at + 1] - day > timedelta(days=1)]
    pairs = zip(firsts, lasts, strict=True)
    return ", ".join(f"{first:%m-%d} to {last:%m-%d}" if first != last else f"{first:%m-%d}" for first, last in pairs)


def _comes(leaf: ScheduleCondition, latitude_deg: float) -> bool:
    """Check whether a schedule by the sun ever holds: its days may all be without sunrise and sunset."""
    for number in range(_AHEAD_DAYS):
        dates = tuple(
            MonthDay(day.month, day.day) for day in (_YEAR + timedelta(days=number + by) for by in (-1, 0, 1))
        )
        rises_s, sets_s = _polar_sun_s(latitude_deg, number) or (None, None)
        # On a day without both it holds from its beginning, to its end, all day, or not at all.
        for second in (0.0, DAY_S / 2, DAY_S - 1) if leaf.begins_on(dates[1]) else ():
            wall = WallTime(second_of_day=second, weekday=0, dates=dates, sunrise_s=rises_s, sunset_s=sets_s)
            if replace(leaf, weekdays=()).covers(wall) is not False:
                return True
    return False


def _polar_sun_s(latitude_deg: float, number: int) -> tuple[float, float] | None:
    """Return sunrise and sunset, as in `WallTime`, on a day of the year without either; None if there may be one.

    The height of the sun's middle at noon and at midnight follows from its declination, which is right to a degree.
    """
    declination_deg = -_TROPIC_DEG * math.cos(2 * math.pi * (number + 10) / 365.25)
    noon_deg, midnight_deg = 90 - abs(latitude_deg - declination_deg), abs(latitude_deg + declination_deg) - 90
    if noon_deg < HORIZON_DEG - 1:
        return math.inf, -math.inf
    return (-math.inf, math.inf) if midnight_deg > HORIZON_DEG + 1 else None


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
    return [day for day, after in pairwise(_days_ahead(zone)) if _offsets_s(day, zone) != _offsets_s(after, zone)]


def _days_ahead(zone: tzinfo | None) -> list[datetime]:
    today = datetime.combine(datetime.now(zone), datetime.min.time())
    return [today + timedelta(days=number) for number in range(_AHEAD_DAYS + 1)]


def _at_change(
    leaf: ScheduleCondition, does: str, if_skipped: str, at_s: float, zone: tzinfo | None, days: list[datetime]
) -> Iterator[str]:
    """Say what becomes of one end of a schedule, or of a message, when clocks are changed."""
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
            once = f"does not come: it {if_skipped}"
            yield f"{what} {once if first_s < second_s else f'comes twice, and it {does} twice'}"


def _offsets_s(shown: datetime, zone: tzinfo | None) -> tuple[float, ...]:
    """Return the offsets from universal time of what clocks show: they differ where it is skipped, or comes twice."""
    at = (shown.replace(tzinfo=zone, fold=fold).astimezone(zone) for fold in (0, 1))
    return tuple((each.utcoffset() or timedelta()).total_seconds() for each in at)
