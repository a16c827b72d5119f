"""Whether it is a certain time of day, local time. Unknown while the clock is not synchronised."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.intervals import NOT_KNOWN, YES, Box, Intervals, Truth, interval, union_of
from stadimeter.core.conditions.leaf import Leaf, Rest
from stadimeter.core.observation import WallTime
from stadimeter.core.words import day, time_of_day

_DAY_S = 86400.0
_WEEK_S = 7 * _DAY_S


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleCondition(Leaf):
    """Whether it is a certain time of day, local time. Unknown while the clock is not synchronised.

    Attributes:
        from_s: It begins this long after midnight.
        to_s: It ends this long after midnight; before or at `from_s`, on the day after.
        weekdays: On these days, 0 for Monday; the day on which it begins counts. Empty for every day.
    """

    from_s: float
    to_s: float
    weekdays: tuple[int, ...] = ()

    noun = "time of day"
    is_by_cycle = True
    is_sure = True

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Return whether it holds; see `Leaf.holds`."""
        return None if inputs.wall is None else self.covers(inputs.wall)

    def covers(self, wall: WallTime) -> bool:
        """Return whether a local time of day is within it."""
        second, days = wall.second_of_day, self.weekdays
        is_today = not days or wall.weekday in days
        if self.from_s < self.to_s:
            return is_today and self.from_s <= second < self.to_s
        began_yesterday = not days or (wall.weekday - 1) % 7 in days
        return (is_today and second >= self.from_s) or (began_yesterday and second < self.to_s)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest | None:  # noqa: ARG002
        """Return that it is judged in every cycle: the time of day goes by another clock, which may jump."""
        return None

    def in_words(self, inputs: RuleInputs, is_on: bool, *, names_target: bool) -> str:  # noqa: ARG002
        """Return the time of day; see `Leaf.in_words`."""
        when = self._when()
        if inputs.wall is None:
            return f"the time of day is not known yet, {when}"
        return f"{day(inputs.wall.weekday)} {time_of_day(inputs.wall.second_of_day // 60 * 60)}, {when}"

    def _when(self) -> str:
        days = f" on {' and '.join(map(day, self.weekdays))}" if self.weekdays else ""
        return f"between {time_of_day(self.from_s)} and {time_of_day(self.to_s)}{days}"

    def begins(self) -> str:
        """Return a clause that says when it begins."""
        return f"it is {self._when()}"

    def week(self) -> Intervals:
        """Return at which seconds of the week it holds, counted from midnight before Monday."""
        length_s = self.to_s - self.from_s + (0.0 if self.to_s > self.from_s else _DAY_S)
        starts = [number * _DAY_S + self.from_s for number in self.weekdays or range(7)]
        whole = [(start, start + length_s) for start in starts]
        return union_of([*whole, *((low - _WEEK_S, high - _WEEK_S) for low, high in whole)]) & interval(0.0, _WEEK_S)

    def situations(self, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:  # noqa: ARG002
        """Yield the boxes of situations in which it is so; see `Leaf.situations`."""
        if truth is Truth.UNKNOWN:
            yield {("clock",): NOT_KNOWN}
            return
        week = self.week()
        yield {("clock",): YES, ("week",): interval(0.0, _WEEK_S) & (week if truth is Truth.TRUE else ~week)}
