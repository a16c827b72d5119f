"""Schedules by an unknown sun, or at a time that clocks skip or show twice; rules in an order that never is."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from datetime import datetime, timedelta, tzinfo
from itertools import pairwise

from msgspec.structs import replace

from stadimeter.config.analysis import Subject
from stadimeter.config.draft import Draft
from stadimeter.config.extras import missing
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import WrittenCondition
from stadimeter.config.rules.tables import RuleTable
from stadimeter.config.sun import HORIZON_DEG, sun_times_s
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.alarms.state import MINUTE_S
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.of_rules import SequenceCondition
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import SLOTS, RememberedCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.rule import AlarmRule, AnyRule, ReportRule
from stadimeter.core.rules.ramp import LATE_S
from stadimeter.core.words import time_of_day

# The memory over a window of time: counts and sums that cannot be, figures, and messages at times ---------------------

_STEP_KEYS = ("actuator", "after", "on", "only_unacknowledged")


def memory_errors(subject: Subject) -> Iterator[Finding]:
    """Find sums longer than their window, figures of no target or in another unit, and messages that are none.

    Messages at times are never active, so that nothing can wait for them or count them.
    """
    messages = {each.rule.name for each in subject.rules if isinstance(each.rule, ReportRule)}
    for leaf in subject.leaves:
        condition = leaf.leaf
        for name in sorted(messages.intersection(condition.rules_named)):
            message = f"'{name}' sends messages at its times, and is never active"
            yield Finding(leaf.limits_path, message, "name a rule that has when, ramp or follow", "never-true")
        if not isinstance(condition, RememberedCondition):
            continue
        longest_s = condition.window.for_s * (SLOTS - 1) / SLOTS
        if condition.unit == "s" and (condition.above or 0.0) >= longest_s and condition.rules:
            message = f"no rule is active for {condition.above:g} s {condition.window}: {longest_s:g} s at most"
            yield Finding((*leaf.limits_path, "at_least"), message, "write a longer window", "never-true")
        figure = subject.draft.figures.get(condition.name)
        if figure is not None and condition.unit and condition.unit != (unit := QUANTITIES[figure.of].unit):
            message = f"the figure '{condition.name}' is in {unit}, and not in {condition.unit}"
            yield Finding(leaf.limits_path, message, f"write its limits in {unit}", "bad-value")
    yield from _figures(subject.draft)
    for declared in subject.rules:
        if isinstance(declared.rule, ReportRule):
            yield from _report(declared.path, subject.draft.rules[declared.section])


def _figures(draft: Draft) -> Iterator[Finding]:
    names = draft.names("targets")
    for name, figure in draft.figures.items():
        if figure.target is None and len(names) > 1:
            message = f"which of the targets {', '.join(draft.tables('targets'))} is '{name}' of?"
            yield Finding(("figures", name, "target"), message, draft.any_target_hint, "target-missing")
        elif figure.target is not None and figure.target not in draft.target_names:
            hint = draft.target_hint(figure.target)
            yield Finding(("figures", name, "target"), f"there is no target '{figure.target}'", hint, "unknown-name")


def memory_warnings(subject: Subject) -> Iterator[Finding]:
    """Find counts that are never reached, however often the rule that is counted would be raised."""
    rules = {each.rule.name: each.rule for each in subject.every_rule}
    for leaf in subject.leaves:
        condition = leaf.leaf
        if not isinstance(condition, RememberedCondition):
            continue
        most = sum(_raises_max(rules.get(name), condition.window.for_s) for name in condition.rules)
        if condition.unit == "times" and (condition.above or 0.0) >= most:
            message = f"{' or '.join(condition.rules)} can be raised {most:g} times {condition.window} at most"
            hint = "count fewer; on_delay, off_delay and raises_per_min_max of that rule limit it"
            yield Finding((*leaf.limits_path, "at_least"), message, hint, "never-true")


def _raises_max(rule: AnyRule | None, for_s: float) -> float:
    """Count how often a rule can be raised within a window: by its delays, and by its limit on chattering."""
    if not isinstance(rule, AlarmRule):
        return math.inf
    period_s, most = rule.on_delay.hold_s + rule.off_delay_s, rule.raises_per_min_max
    by_delays = math.ceil(for_s / period_s) if period_s else math.inf
    return min(by_delays, most * math.ceil(for_s / MINUTE_S) if most else math.inf)


def _report(at: KeyPath, rule: RuleTable) -> Iterator[Finding]:
    """Find messages at times that would drive something, say nothing, or come twice in one moment."""
    wrong: list[KeyPath] = [(*at, "actuator")] if rule.actuator is not None else []
    for number, step in enumerate(rule.escalation):
        wrong += [(*at, "escalation", number, key) for key in _STEP_KEYS if key in step.model_fields_set]
    for path in wrong:
        message = f"'{path[-1]}' has no meaning beside every or at: such a rule sends at its times, and no more"
        yield Finding(path, message, "leave it out", "key-of-another-kind")
    if not rule.steps:
        yield Finding(at, f"the rule '{at[-1]}' sends nothing", "add notify, or a step with topic", "missing-key")
    times = sorted(rule.at or [0.0])
    if any(later - time < 2 * LATE_S for time, later in zip(times, [*times[1:], times[0] + DAY_S], strict=True)):
        yield Finding((*at, "at"), "two of the times are less than 2 min apart", "leave one out", "bad-value")


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
