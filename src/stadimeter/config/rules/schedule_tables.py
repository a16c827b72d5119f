"""The tables of conditions on time: schedules by the clock, the calendar and the sun, and the order of rules."""

import re
from calendar import monthrange
from datetime import date
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.units import parse_duration, parse_time_of_day
from stadimeter.core.conditions.discrete import DateSpan, ScheduleCondition, Sun
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.observation import MonthDay

# The days of the week as they are written, Monday first.
DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")

# A time further from the sun than this is nearer to the sunrise or sunset of another day.
MAX_FROM_SUN_S = 12 * 3600.0

_SUN = re.compile(r"\s*(sunrise|sunset)\s*(?:([+-])\s*(.+))?")
_CLOCK = r"^\s*([0-9]{1,2}:[0-9]{2}(:[0-9.]+)?|(sunrise|sunset)(\s*[+-].+)?)\s*$"
_DAYS = re.compile(r"\s*([0-9]{1,2})-([0-9]{1,2})\s*(?:\.\.\s*([0-9]{1,2})-([0-9]{1,2})\s*)?")

# 29 February is a day, though not of every year.
_LEAP_YEAR = 2000


def parse_hour(text: object) -> tuple[Sun, float]:
    """Read a time of day such as ``"22:30"`` or ``"sunset + 30 min"``; raises ValueError if it is none.

    Returns:
        What it is counted from, empty for midnight, and how many seconds after that it is.
    """
    match = _SUN.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        return "", parse_time_of_day(text)
    sun: Sun = "sunrise" if match[1] == "sunrise" else "sunset"
    away_s = parse_duration(match[3].strip()) if match[3] else 0.0
    if away_s > MAX_FROM_SUN_S:
        raise ValueError(f"{text!r} is more than 12 h away from the {sun}; count from the other one, or name an hour")
    return sun, -away_s if match[2] == "-" else away_s


def parse_date(text: object) -> object:
    """Read a date such as ``"2026-12-24"``; raises ValueError for another text, and leaves what is no text."""
    try:
        return date.fromisoformat(text) if isinstance(text, str) else text
    except ValueError:
        raise ValueError(f"{text!r} is no date; write it such as '2026-12-24'") from None


def parse_dates(text: object) -> DateSpan:
    """Read days such as ``"12-24..12-26"``; raises ValueError if they are none."""
    match = _DAYS.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        raise ValueError(f"{text!r} is no span of days; write months and days, such as '12-24..12-26'")
    numbers = [int(number) for number in match.groups(default=0)]
    first, last = MonthDay(*numbers[:2]), MonthDay(*(numbers[2:] if match[3] else numbers[:2]))
    for each in (first, last):
        if not 1 <= each.month <= 12 or not 1 <= each.day <= monthrange(_LEAP_YEAR, each.month)[1]:
            raise ValueError(f"{each.month:02d}-{each.day:02d} is on no calendar; write the month first, then the day")
    return DateSpan(first, last)


Hour = Annotated[Any, BeforeValidator(parse_hour), WithJsonSchema({"type": "string", "pattern": _CLOCK})]
Dates = Annotated[
    Any, BeforeValidator(parse_dates), WithJsonSchema({"type": "string", "pattern": f"^{_DAYS.pattern}$"})
]


class TimeTable(Section):
    """A condition on the time of day, local time."""

    between: Annotated[list[Hour], Field(min_length=2, max_length=2)]
    """The beginning first, each by the clock, or by the sun of the place; over midnight if the end is earlier."""
    days: Annotated[list[Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]], Field(min_length=1)] | None = None
    """The days on which it begins; every day if left out."""
    dates: Annotated[list[Dates], Field(min_length=1, max_length=100)] | None = None
    """The dates of every year on which it begins; every day if left out."""

    def to_plan(self) -> ScheduleCondition:
        """Return the condition as the core sees it."""
        weekdays = tuple(sorted({DAYS.index(day) for day in self.days or ()}))
        (from_sun, from_s), (to_sun, to_s) = self.between
        by_sun = {"from_sun": from_sun, "to_sun": to_sun}
        return ScheduleCondition(from_s=from_s, to_s=to_s, weekdays=weekdays, dates=tuple(self.dates or ()), **by_sun)


class SequenceTable(Section):
    """A condition on the order in which rules were raised."""

    rules: Annotated[list[str], Field(min_length=2, max_length=10)]
    """Their names, the first to be raised first."""
    within: DurationAboveZero
    """In seconds, from the first to the last."""
    for_: Annotated[DurationAboveZero | None, Field(alias="for")] = None
    """For how long it holds then, in seconds, written ``for``; None for as long as the last is active."""

    def to_plan(self) -> SequenceCondition:
        """Return the condition as the core sees it."""
        return SequenceCondition(rules=tuple(self.rules), within_s=self.within, for_s=self.for_)
