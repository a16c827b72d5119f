"""Whether it is a certain time of day, local time. Unknown while the clock is not synchronised."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.leaf import Leaf, Rest
from stadimeter.core.observation import WallTime


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
