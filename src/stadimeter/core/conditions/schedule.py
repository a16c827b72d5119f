"""The condition that it is a certain time, by the clock, the calendar and the sun."""

from __future__ import annotations

import math
from typing import Literal

from msgspec import Struct

from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.leaf import Leaf, RuleInputs
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.words import day, duration, time_of_day

Sun = Literal["", "sunrise", "sunset"]

# When the sun rises and sets at the equinoxes, everywhere.
_USUAL_SUN_S = {"": 0.0, "sunrise": DAY_S / 4, "sunset": DAY_S * 3 / 4}


class DateSpan(Struct, frozen=True):
    """Days of every year from one to another, both included, over its end if the second is earlier."""

    first: MonthDay
    last: MonthDay

    def covers(self, date: MonthDay) -> bool:
        """Check whether a day is among them."""
        if self.first <= self.last:
            return self.first <= date <= self.last
        return date >= self.first or date <= self.last

    def __str__(self) -> str:
        """Return the days such as ``12-24 to 12-26``, as they are written."""
        first, last = _month_and_day(self.first), _month_and_day(self.last)
        return first if first == last else f"{first} to {last}"


class ScheduleCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition that it is a certain time of day, local time. Unknown while the clock is not synchronised.

    Attributes:
        from_s: It begins this long after midnight, or after what `from_sun` names.
        to_s: It ends this long after midnight, or after what `to_sun` names, on that day or the day after.
        weekdays: On these days, 0 for Monday; the day on which it begins counts. Empty for every day.
        dates: In these spans, likewise; empty for every day.
        from_sun: Empty for midnight.
    """

    from_s: float
    to_s: float
    weekdays: tuple[int, ...] = ()
    dates: tuple[DateSpan, ...] = ()
    from_sun: Sun = ""
    to_sun: Sun = ""

    noun = "time of day"
    is_by_cycle = True
    has_noise = False

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Check whether it holds; see `Leaf.holds`."""
        return None if inputs.wall is None else self.covers(inputs.wall)

    @property
    def is_by_sun(self) -> bool:
        """True if it goes by the sun."""
        return bool(self.from_sun or self.to_sun)

    @property
    def _ends_next_day(self) -> bool:
        """True if it ends on the day after it begins.

        Two times of the clock do where the second is not the later one. With the sun that differs from season to
        season, so there it is what begins in the afternoon and ends in the morning, with sunrise taken at 6 and sunset
        at 18 o'clock. From sunset to 22:00 then holds on no other day, however late the sun sets.
        """
        if not self.is_by_sun:
            return self.to_s <= self.from_s
        begins_s, ends_s = _USUAL_SUN_S[self.from_sun] + self.from_s, _USUAL_SUN_S[self.to_sun] + self.to_s
        return begins_s >= DAY_S / 2 >= ends_s

    def interval_s(self, wall: WallTime) -> tuple[float, float] | None:
        """Return when it begins and ends, in seconds since midnight; None if the sun is not known.

        It is empty where the end is not the later one.
        """
        low_s = _of_day(wall, self.from_sun, self.from_s) if self.from_sun else self.from_s
        high_s = _of_day(wall, self.to_sun, self.to_s) if self.to_sun else self.to_s
        if low_s is None or high_s is None:
            return None
        return low_s, high_s + DAY_S * self._ends_next_day

    def covers(self, wall: WallTime) -> bool | None:
        """Check whether a local time of day is within it; None if the date or the sun is not known."""
        interval_s = self.interval_s(wall)
        if interval_s is None or (self.dates and not wall.dates):
            return None
        low_s, high_s = interval_s
        now_s = wall.second_of_day
        # It may have begun yesterday; and one of tomorrow that begins long before sunrise may begin today.
        for later in (0, -1, 1) if low_s < 0 else (0, -1):
            if low_s <= now_s - later * DAY_S < high_s and self._begins(wall, later):
                return True
        return False

    def begins_on(self, date: MonthDay) -> bool:
        """Check whether a day is among its dates."""
        return not self.dates or any(span.covers(date) for span in self.dates)

    def _begins(self, wall: WallTime, later: int) -> bool:
        """Check whether it begins on a day, 1 for tomorrow."""
        if self.weekdays and (wall.weekday + later) % 7 not in self.weekdays:
            return False
        return not self.dates or self.begins_on(wall.dates[1 + later])

    @property
    def begins(self) -> str:
        """The hours."""
        return f"it is {self.hours}"

    @property
    def hours(self) -> str:
        """The time that it holds, such as ``between 22:00 and 06:00 on Monday``."""
        days = f" on {' and '.join(map(day, self.weekdays))}" if self.weekdays else ""
        spans = [str(span) for span in self.dates]
        dates = f" on {' and '.join(spans)}" if spans else ""
        return f"between {_hour(self.from_sun, self.from_s)} and {_hour(self.to_sun, self.to_s)}{days}{dates}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the time of day, and when it holds; see `Leaf.verdict`."""
        wall = inputs.wall
        if wall is None:
            return f"the time of day is not known yet, {self.hours}"
        today = f"{day(wall.weekday)}{f' {_month_and_day(wall.dates[1])}' if self.dates and wall.dates else ''}"
        return f"{today} {time_of_day(wall.second_of_day // 60 * 60)}, {self.hours}{self._sun_today(wall)}"

    def _sun_today(self, wall: WallTime) -> str:
        """Say when the sun rises and sets, where a schedule goes by it."""
        if self.dates and not wall.dates:
            return ": the date is not known"
        if not (self.from_sun or self.to_sun):
            return ""
        if wall.sunrise_s is None or wall.sunset_s is None:
            return ": when the sun rises and sets is not known"
        if math.isinf(wall.sunrise_s) and math.isinf(wall.sunset_s):
            return f" (the sun is {'up' if wall.sunset_s > 0 else 'down'} all day)"
        times = (("sunrise", wall.sunrise_s), ("sunset", wall.sunset_s))
        return f" ({', '.join(f'{sun} {time_of_day(at_s // 60 * 60)}' for sun, at_s in times if math.isfinite(at_s))})"


def _of_day(wall: WallTime, sun: Sun, after_s: float) -> float | None:
    """Return a time of a schedule in seconds since midnight; None if it goes by a sun that is not known."""
    sun_s = wall.sunrise_s if sun == "sunrise" else wall.sunset_s
    return None if sun_s is None else sun_s + after_s


def _hour(sun: str, second: float) -> str:
    """Return a time of a schedule such as ``22:30`` or ``30 min after sunset``."""
    if not sun:
        return time_of_day(second)
    side = "after" if second > 0 else "before"
    return f"{duration(abs(second))} {side} {sun}" if second else sun


def _month_and_day(date: MonthDay) -> str:
    return f"{date.month:02d}-{date.day:02d}"
