"""Conditions on what is known or not, but never unsure: presence, count, time of day, another rule."""

from __future__ import annotations

import math
from typing import Literal

from msgspec import Struct

from stadimeter.core.bounds import MAX_DURATION_S, MIN_QUANTITY
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.leaf import IN_SIGHT, JudgedFigure, Leaf, RuleInputs, Span, Threshold
from stadimeter.core.conditions.limits import ends_of
from stadimeter.core.decision import SafetyMode
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.words import day, duration, length, time_of_day

Sun = Literal["", "sunrise", "sunset"]

_RULE_STATES = {True: "is active", False: "is not active", None: "has nothing to judge by"}

# When the sun rises and sets at the equinoxes, everywhere.
_USUAL_SUN_S = {"": 0.0, "sunrise": DAY_S / 4, "sunset": DAY_S * 3 / 4}


class PresenceCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition on whether the target is in sight.

    Attributes:
        seen: True: holds while the target is tracked. False: holds while it is lost or was never seen.
        for_s: Only when that has been so for this long without a break.
        target: The target; empty for that of the rule.
    """

    seen: bool
    for_s: float = 0.0
    target: str = ""

    noun = "presence"
    is_by_cycle = is_on_sight = True

    @property
    def unit(self) -> str:
        """Seconds, for one that takes time."""
        return "s" if self.for_s else ""

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The time, for one that takes time; one that takes none is another condition, ``seen`` or ``lost``."""
        key = "seen" if self.seen else "lost"
        return (Threshold(key, "for_s", MIN_QUANTITY, MAX_DURATION_S),) if self.for_s else ()

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Its target."""
        return (self.target,)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool:  # noqa: ARG002 - nothing is unsure of it
        """Check whether it holds; see `Leaf.holds`."""
        track = inputs.tracks[self.target]
        if track.is_valid is not self.seen:
            return False
        return not self.for_s or (track.since_s is not None and inputs.now_s >= track.since_s + self.for_s)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return for how many seconds it has been so, for one that takes time."""
        if not self.for_s:
            return None
        track = inputs.tracks[self.target]
        is_so = track.is_valid is self.seen and track.since_s is not None
        held_s = inputs.now_s - track.since_s if is_so and track.since_s is not None else 0.0
        return JudgedFigure(value=held_s, low=self.for_s)

    @property
    def span(self) -> Span | None:
        """The stretch of the time in sight, which is below zero out of it; see `Leaf.span`."""
        limits = (self.for_s, math.inf) if self.seen else (-math.inf, -self.for_s)
        return Span((IN_SIGHT, self.target), *limits)

    @property
    def begins(self) -> str:
        """A clause on sight, and on the time."""
        since = f" for {duration(self.for_s)}" if self.for_s else ""
        return f"`{self.target}` is {'in' if self.seen else 'out of'} sight{since}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the state of the track, and since when; see `Leaf.verdict`."""
        track = inputs.tracks[self.target]
        words = f"{track.target} is {track.status.value}"
        if self.for_s and track.is_valid is self.seen and track.since_s is not None:
            words += f" for {inputs.now_s - track.since_s:.1f} s of {self.for_s:g} s"
        return words + (f": {track.reason}" if track.reason else "")


class CountCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition on the number of targets in sight.

    Attributes:
        targets: Of these; empty for all.
        at_least: Holds with no fewer than this; None for no such threshold.
        at_most: Holds with no more than this.
        below_m: Only those that are nearer than this count; None for all that are in sight.
    """

    targets: tuple[str, ...] = ()
    at_least: int | None = None
    at_most: int | None = None
    below_m: float | None = None

    noun = "count"
    is_by_cycle = is_on_sight = True

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Those that it counts; empty for all."""
        return self.targets

    @property
    def where(self) -> str:
        """The place of those that count, in words."""
        return "in sight" if self.below_m is None else f"nearer than {length(self.below_m)}"

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Check whether it holds; see `Leaf.holds`. Unknown while no fresh frame says what is in sight."""
        count = self.count(inputs)
        if count is None:
            return None
        least, most = self.at_least, self.at_most
        return (least is None or count >= least) and (most is None or count <= most)

    def count(self, inputs: RuleInputs) -> int | None:
        """Count its targets that are in sight, and near enough to count; None while the camera is stale."""
        if inputs.safety is SafetyMode.STALE:
            return None
        tracks = [inputs.tracks[target] for target in self.targets or inputs.tracks]
        if self.below_m is None:
            return sum([track.is_valid for track in tracks])
        return sum([track.is_valid and (track.distance_m or math.inf) < self.below_m for track in tracks])

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return the count; None where it is not known."""
        low, high = ends_of(self.at_least, self.at_most)
        count = self.count(inputs)
        return None if count is None else JudgedFigure(value=float(count), low=low, high=high)

    @property
    def begins(self) -> str:
        """A clause on the number, and of which targets."""
        least, most = self.at_least, self.at_most
        if least is None or most is None:
            number = f"at most {most}" if least is None else f"at least {least}"
        else:
            number = f"{least}" if least == most else f"{least} to {most}"
        counted = f"of {', '.join(f'`{each}`' for each in self.targets)}" if self.targets else "targets"
        return f"{number} {counted} are {self.where}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return how many are in sight; see `Leaf.verdict`."""
        pairs = (("at least", self.at_least), ("at most", self.at_most))
        thresholds = [f"{word} {limit}" for word, limit in pairs if limit is not None]
        counted = self.count(inputs)
        words = "unknown how many" if counted is None else f"{counted}"
        return f"{words} of {len(self.targets or inputs.tracks)} {self.where}, {' and '.join(thresholds)}"


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


class RuleCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition that another rule is active. Unknown while that rule has nothing to judge by."""

    rule: str

    noun = "rule"
    is_by_cycle = True
    has_noise = False

    @property
    def rules_named(self) -> tuple[str, ...]:
        """That rule."""
        return (self.rule,)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Check whether it holds; see `Leaf.holds`."""
        return inputs.active.get(self.rule)

    @property
    def begins(self) -> str:
        """The rule."""
        return f"`{self.rule}` is active"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the state of the rule; see `Leaf.verdict`."""
        return f"the rule {self.rule} {_RULE_STATES[inputs.active.get(self.rule)]}"


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
