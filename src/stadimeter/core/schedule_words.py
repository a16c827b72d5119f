"""Schedules and sequences in words."""

from __future__ import annotations

import math

from stadimeter.core.conditions.discrete import DateSpan, ScheduleCondition
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.words import day, duration, time_of_day


def clock_words(leaf: ScheduleCondition, inputs: RuleInputs) -> str:
    """Return the time of day, and when a schedule holds."""
    if inputs.wall is None:
        return f"the time of day is not known yet, {hours(leaf)}"
    wall = inputs.wall
    today = f"{day(wall.weekday)}{f' {_month_and_day(wall.dates[1])}' if leaf.dates and wall.dates else ''}"
    return f"{today} {time_of_day(wall.second_of_day // 60 * 60)}, {hours(leaf)}{_sun_today(leaf, wall)}"


def _sun_today(leaf: ScheduleCondition, wall: WallTime) -> str:
    """Say when the sun rises and sets, where a schedule goes by it."""
    if leaf.dates and not wall.dates:
        return ": the date is not known"
    if not (leaf.from_sun or leaf.to_sun):
        return ""
    if wall.sunrise_s is None or wall.sunset_s is None:
        return ": when the sun rises and sets is not known"
    if math.isinf(wall.sunrise_s) and math.isinf(wall.sunset_s):
        return f" (the sun is {'up' if wall.sunset_s > 0 else 'down'} all day)"
    times = (("sunrise", wall.sunrise_s), ("sunset", wall.sunset_s))
    return f" ({', '.join(f'{sun} {time_of_day(at_s // 60 * 60)}' for sun, at_s in times if math.isfinite(at_s))})"


def sequence_words(leaf: SequenceCondition, inputs: RuleInputs) -> str:
    """Return when each rule of a sequence was raised last."""
    now_s, raised_at_s = inputs.now_s, inputs.raised_at_s
    ago = [
        f"{rule} was raised {now_s - raised_at_s[rule]:.1f} s ago" if rule in raised_at_s else f"{rule} was not raised"
        for rule in leaf.rules
    ]
    return f"{', '.join(ago)}; in this order within {duration(leaf.within_s)}"


def hours(leaf: ScheduleCondition) -> str:
    """Return when a schedule holds, such as ``between 22:00 and 06:00 on Monday``."""
    days = f" on {' and '.join(map(day, leaf.weekdays))}" if leaf.weekdays else ""
    spans = [_span_of_days(span) for span in leaf.dates]
    dates = f" on {' and '.join(spans)}" if spans else ""
    return f"between {_hour(leaf.from_sun, leaf.from_s)} and {_hour(leaf.to_sun, leaf.to_s)}{days}{dates}"


def _hour(sun: str, second: float) -> str:
    """Return a time of a schedule such as ``22:30`` or ``30 min after sunset``."""
    if not sun:
        return time_of_day(second)
    side = "after" if second > 0 else "before"
    return f"{duration(abs(second))} {side} {sun}" if second else sun


def _span_of_days(span: DateSpan) -> str:
    """Return days such as ``12-24 to 12-26``, as they are written."""
    first, last = _month_and_day(span.first), _month_and_day(span.last)
    return first if first == last else f"{first} to {last}"


def _month_and_day(date: MonthDay) -> str:
    return f"{date.month:02d}-{date.day:02d}"


def describe_sequence(leaf: SequenceCondition) -> str:
    r"""Return a clause such as ``\`left\` and then \`right\` are raised within 2 s``."""
    names = " and then ".join(f"`{rule}`" for rule in leaf.rules)
    lasts = "" if leaf.for_s is None else f", for {duration(leaf.for_s)} from then on"
    return f"{names} are raised within {duration(leaf.within_s)}{lasts}"
