"""Whether conditions can hold together: a search through the situations in which their parts do.

What cannot be known is neither true nor false, so that a goal may be any of four: true, false, not true (false or
unknown) and not false.

A situation says where each target is, how long it has been in sight, which rules are active, and what time it is. Each
of these is one number on an axis of its own, so a set of situations is a box: for each axis a union of intervals. With
boxes it is exact whether several conditions can hold together: no sampling, and no solver but the intersection of
intervals. Ends do not count: no measurement is exactly at a threshold.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import date, timedelta
from enum import Enum
from typing import Any

from msgspec import Struct, field

from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.discrete import CountCondition, PresenceCondition, RuleCondition, ScheduleCondition
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.limits import ends_of
from stadimeter.core.conditions.measured import DIFFERENCE, FigureCondition
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.conditions.summary import SLOTS
from stadimeter.core.observation import MonthDay

_WEEK_S = 7 * DAY_S
_YEAR_DAYS = 366


class Intervals(Struct, frozen=True):
    """A union of intervals that do not touch, in rising order.

    Attributes:
        parts: The lower and the upper end of each.
    """

    parts: tuple[tuple[float, float], ...]

    @property
    def is_empty(self) -> bool:
        """Whether no number is in it."""
        return not self.parts

    def __and__(self, other: Intervals) -> Intervals:
        """Return what is in both."""
        return union_of(
            (max(low, other_low), min(high, other_high))
            for low, high in self.parts
            for other_low, other_high in other.parts
        )

    def __invert__(self) -> Intervals:
        """Return what is not in it."""
        ends = [-math.inf, *(end for part in self.parts for end in part), math.inf]
        return union_of(zip(ends[::2], ends[1::2], strict=True))


def interval(low: float | None, high: float | None) -> Intervals:
    """Return one interval; None for an end that is free. It is empty if the ends are not in order."""
    return union_of([(-math.inf if low is None else low, math.inf if high is None else high)])


def union_of(parts: Iterable[tuple[float, float]]) -> Intervals:
    """Return the union of intervals, which may overlap. Those whose ends are not in order are empty."""
    merged: list[tuple[float, float]] = []
    for low, high in sorted((low, high) for low, high in parts if low < high):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return Intervals(tuple(merged))


# Such as ``("distance", "ball")``. The axis ``("in sight", TARGET)`` is for how many seconds the target has been in
# sight, and below zero for how many it has been lost.
Axis = tuple[Any, ...]

# A set of situations: for each axis a union of intervals. Axes that it does not name are free.
Box = Mapping[Axis, Intervals]

# The axis ``(_SUM, UNIT, RULES, SECONDS)`` is for what rules did within a window that slides.
_SUM = "sum"

# Quantities that are part of another one, on whichever side of zero.
_PARTS = {
    **dict.fromkeys(("depth", "x", "y", "z", "height above camera"), "distance"),
    **dict.fromkeys(("closing speed", "sideways speed"), "speed"),
}

# Answers, as intervals on an axis of their own.
YES, NO, NOT_KNOWN = interval(0.0, 1.0), interval(-1.0, 0.0), interval(1.0, 2.0)

# On the axis ``("in sight", TARGET)``.
SEEN, GONE = interval(0.0, None), interval(None, 0.0)
ALL, LENGTHS = interval(None, None), interval(0.0, None)


class Truth(Enum):
    """Three-valued."""

    TRUE = "true"
    FALSE = "false"
    UNKNOWN = "unknown"


def situations(leaf: Leaf, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:  # noqa: C901 - one for each kind
    """Yield the boxes of situations in which a simple condition is true, false or unknown, as `truth` says.

    Args:
        targets: All targets there are, for a count of all.
    """
    match leaf:
        case PresenceCondition():
            if truth is not Truth.UNKNOWN:
                holds = interval(leaf.for_s, None) if leaf.seen else interval(None, -leaf.for_s)
                yield {("in sight", leaf.target): holds if truth is Truth.TRUE else ~holds}
        case CountCondition():
            if truth is not Truth.UNKNOWN:
                yield _count(leaf, truth, tuple(sorted(set(leaf.targets or targets))))
        case ScheduleCondition():
            yield from _clock(leaf, truth)
        case SequenceCondition():
            # It ends with its last rule, unless it lasts for a time.
            last = {Truth.UNKNOWN: NOT_KNOWN, Truth.FALSE: ALL, Truth.TRUE: YES if leaf.for_s is None else ALL}[truth]
            yield {("sequence", leaf): YES if truth is Truth.TRUE else NO, ("rule", leaf.rules[-1]): last}
        case RuleCondition():
            yield {("rule", leaf.rule): {Truth.TRUE: YES, Truth.FALSE: NO, Truth.UNKNOWN: NOT_KNOWN}[truth]}
        case TimeToContactCondition():
            yield from _contact(leaf, truth)
        case _:
            yield from _measured(leaf, truth)


def week_of(schedule: ScheduleCondition) -> Intervals:
    """Return at which seconds of the week a schedule holds, counted from midnight before Monday."""
    length_s = schedule.to_s - schedule.from_s + (0.0 if schedule.to_s > schedule.from_s else DAY_S)
    starts = [number * DAY_S + schedule.from_s for number in schedule.weekdays or range(7)]
    whole = [(start, start + length_s) for start in starts]
    return union_of([*whole, *((low - _WEEK_S, high - _WEEK_S) for low, high in whole)]) & interval(0.0, _WEEK_S)


def _measured(leaf: Leaf, truth: Truth) -> Iterator[Box]:
    """Yield the boxes of a condition on one figure, which is an axis of its targets and unknown without any of them.

    One on no target is on what the base reports, or does not, unless it is always known.
    """
    sights = [("in sight", target) for target in leaf.targets_named]
    if not sights and not leaf.is_always_known:
        sights = [("reported", leaf.noun)]
    if truth is Truth.UNKNOWN:
        yield from ({sight: GONE} for sight in sights)
        return
    limits = leaf.limits
    if (
        isinstance(leaf, FigureCondition) and leaf.is_comparison and leaf.target > leaf.other
    ):  # one axis for both directions
        limits = -limits[1], -limits[0]
    inside, possible = interval(*limits), ALL if leaf.is_signed else LENGTHS
    axis: Axis = (leaf.noun, *sorted(leaf.targets_named))
    if isinstance(leaf, RememberedCondition) and leaf.rules and leaf.window.from_second is None:
        axis = _SUM, leaf.unit, leaf.rules, leaf.window.for_s
    yield {**dict.fromkeys(sights, SEEN), axis: possible & (inside if truth is Truth.TRUE else ~inside)}


def _count(leaf: CountCondition, truth: Truth, counted: tuple[str, ...]) -> Box:
    low, high = ends_of(leaf.at_least, leaf.at_most)
    holds = interval(low - 0.5, high + 0.5)
    # Whole numbers from none to all, each with the half before and after it.
    possible = interval(-0.5, len(counted) + 0.5)
    axis = ("count", *counted) if leaf.below_m is None else ("count near", leaf.below_m, *counted)
    return {axis: possible & (holds if truth is Truth.TRUE else ~holds)}


def _clock(leaf: ScheduleCondition, truth: Truth) -> Iterator[Box]:
    if truth is Truth.UNKNOWN:
        yield {("clock",): NOT_KNOWN}
        return
    is_so, parts = truth is Truth.TRUE, dict[Axis, Intervals]()
    if leaf.is_by_sun:
        # Night is when it is not day. How other times by the sun lie to each other depends on the place and the date.
        sides = ((leaf.from_sun, leaf.from_s), (leaf.to_sun, leaf.to_s))
        is_night = sides == (("sunset", 0.0), ("sunrise", 0.0))
        axis = ("by the sun", *(reversed(sides) if is_night else sides), leaf.weekdays)
        parts[axis] = NO if is_so is is_night else YES
    else:
        week = week_of(leaf)
        parts["week",] = interval(0.0, _WEEK_S) & (week if is_so else ~week)
    if leaf.dates:
        days = (date(2000, 1, 1) + timedelta(days=number) for number in range(_YEAR_DAYS))  # of a leap year
        year = (number for number, day in enumerate(days) if leaf.begins_on(MonthDay(day.month, day.day)))
        whole = union_of((day, day + 2.0) for day in year)  # what begins on a day may go on over its midnight
        parts["day of the year",] = interval(0.0, _YEAR_DAYS + 2.0) & (whole if is_so else ~whole)
    each = [parts] if is_so else [{axis: part} for axis, part in parts.items()]
    yield from ({("clock",): YES, **part} for part in each)


def _contact(leaf: TimeToContactCondition, truth: Truth) -> Iterator[Box]:
    sight, sure, closing = ("in sight", leaf.target), ("speed is sure", leaf.target), ("closing speed", leaf.target)
    time = ("time to contact", leaf.target, leaf.contact_m)
    inside = interval(None, leaf.below_s)
    match truth:
        case Truth.TRUE:
            yield {sight: SEEN, sure: YES, time: inside, closing: interval(leaf.closing_min_mps, None)}
        case Truth.FALSE:
            yield {sight: SEEN, sure: YES, time: ~inside}
            yield {sight: SEEN, sure: YES, closing: interval(None, leaf.closing_min_mps)}
        case _:
            yield {sight: GONE}
            yield {sure: NO}


# How many boxes one analysis may look at: some seconds on a small computer. A configuration that people write needs
# some hundreds; beyond the limit everything counts as possible, so that nothing wrong is said.
STEPS = 60_000


class Wanted(Enum):
    """What a condition is to be."""

    TRUE = (Truth.TRUE,)
    FALSE = (Truth.FALSE,)
    NOT_TRUE = (Truth.FALSE, Truth.UNKNOWN)
    NOT_FALSE = (Truth.TRUE, Truth.UNKNOWN)


# Goals that need every operand; the others need one.
_OPPOSITE = {
    Wanted.TRUE: Wanted.FALSE,
    Wanted.FALSE: Wanted.TRUE,
    Wanted.NOT_TRUE: Wanted.NOT_FALSE,
    Wanted.NOT_FALSE: Wanted.NOT_TRUE,
}
_NEEDS_ALL = {AllOf: (Wanted.TRUE, Wanted.NOT_FALSE), AnyOf: (Wanted.FALSE, Wanted.NOT_TRUE)}

# The goals that are left: the first, and those after it. A chain is not copied when a goal is put before it.
Goal = tuple[Condition, Wanted]
_Goals = tuple[Goal, "_Goals"] | None


class Logic(Struct, kw_only=True):
    """Answers which conditions can hold together.

    Attributes:
        steps_left: How many boxes may still be looked at.
    """

    targets: tuple[str, ...]
    steps_left: int = field(default=STEPS)

    def can_be(self, *goals: Goal) -> bool:
        """Return whether there is a situation in which every goal is met; False if there surely is none."""
        branches: list[Iterator[tuple[Box, _Goals]]] = [iter([({}, _chain(goals, None))])]
        while branches:
            branch = next(branches[-1], None)
            if branch is None:
                branches.pop()
                continue
            box, left = branch
            self.steps_left -= 1
            if left is None or self.steps_left <= 0:
                return True
            branches.append(self._branches(box, *left))
        return False

    def _branches(self, box: Box, goal: Goal, rest: _Goals) -> Iterator[tuple[Box, _Goals]]:
        condition, wanted = goal
        match condition:
            case Not():
                yield box, ((condition.condition, _OPPOSITE[wanted]), rest)
            case AllOf() | AnyOf() if wanted in _NEEDS_ALL[type(condition)]:
                yield box, _chain([(part, wanted) for part in condition.conditions], rest)
            case AllOf() | AnyOf():
                for part in condition.conditions:
                    yield box, ((part, wanted), rest)
            case _:
                for narrowed in self._narrowed(box, condition, wanted):
                    yield narrowed, rest

    def _narrowed(self, box: Box, leaf: Leaf, wanted: Wanted) -> Iterator[Box]:
        for truth in wanted.value:
            for situation in situations(leaf, truth, self.targets):
                narrowed = _both(box, situation)
                if is_possible(narrowed):
                    yield narrowed


def _chain(goals: Sequence[Goal], rest: _Goals) -> _Goals:
    for goal in reversed(goals):
        rest = (goal, rest)
    return rest


def _both(box: Box, other: Box) -> Box:
    return {**box, **{axis: box[axis] & part if axis in box else part for axis, part in other.items()}}


def is_possible(box: Box) -> bool:
    """Return whether a situation can be in a box, given what is true of every situation.

    A part is no larger than its whole; as many targets are counted as are in sight; two targets are at most as far
    apart as both distances together, and at least as far as these differ; a longer window has all of a shorter one.
    """
    return not any(part.is_empty for part in box.values()) and all(_fits(box, axis) for axis in box)


def _fits(box: Box, axis: Axis) -> bool:
    name, *names = axis
    if name in _PARTS:
        low, high = _ends(box, axis)
        return max(low, -high) < _ends(box, (_PARTS[name], *names))[1]
    if name == _SUM:
        # What is as old as a window leaves it up to one slot too early.
        longer = (each for each in box if each[:3] == axis[:3] and each[3] * (SLOTS - 1) / SLOTS >= axis[3])
        return all(_ends(box, axis)[0] < _ends(box, each)[1] for each in longer)
    if name == "count":
        sights = [box.get(("in sight", target)) for target in names]
        seen = sum(sight is not None and (sight & GONE).is_empty for sight in sights)
        gone = sum(sight is not None and (sight & SEEN).is_empty for sight in sights)
        return not (box[axis] & interval(seen - 0.5, len(names) - gone + 0.5)).is_empty
    if name == "separation":
        return _triangle(box, axis)
    if name.startswith(DIFFERENCE):
        return _subtraction(box, axis)
    return True


def _subtraction(box: Box, axis: Axis) -> bool:
    """Return whether the difference of two quantities can be what it is to be, given the limits of each."""
    least = 0.0 if axis[0] == f"{DIFFERENCE}distance" else -math.inf
    noun = axis[0].removeprefix(DIFFERENCE)
    (first_low, first_high), (second_low, second_high) = (_ends(box, (noun, target), least) for target in axis[1:])
    low, high = _ends(box, axis, -math.inf)
    return low < first_high - second_low and high > first_low - second_high


def _triangle(box: Box, axis: Axis) -> bool:
    (first_low, first_high), (second_low, second_high) = (_ends(box, ("distance", target)) for target in axis[1:])
    low, high = _ends(box, axis)
    return low < first_high + second_high and high > max(first_low - second_high, second_low - first_high)


def _ends(box: Box, axis: Axis, least: float = 0.0) -> tuple[float, float]:
    parts = box[axis].parts if axis in box else ((least, math.inf),)
    return parts[0][0], parts[-1][1]
