"""In which situations a simple condition holds, does not hold, or cannot be known.

A situation says where each target is, how long it has been in sight, which rules are active, and what time it is. Each
of these is one number on an axis of its own, so a set of situations is a box: for each axis a union of intervals. Axes
that a box does not name are free. With boxes it is exact whether several conditions can hold together: no sampling, and
no solver but the intersection of intervals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from typing import Any

from stadimeter.config.analysis.intervals import Intervals, interval, union_of
from stadimeter.core import condition as core

Axis = tuple[Any, ...]
"""Such as ``("distance", "ball")``. The axis ``("in sight", TARGET)`` is for how many seconds the target has been in
sight, and below zero for how many it has been lost."""

Box = Mapping[Axis, Intervals]

DAY_S = 86400.0
WEEK_S = 7 * DAY_S

_YES = interval(0.0, 1.0)
_NO = interval(-1.0, 0.0)
_UNKNOWN = interval(1.0, 2.0)
_SEEN = interval(0.0, None)
_ALL = interval(None, None)
_LENGTHS = interval(0.0, None)
_GONE = interval(None, 0.0)


class Truth(Enum):
    """What a condition turns out to be."""

    TRUE = "true"
    FALSE = "false"
    UNKNOWN = "unknown"


def situations(leaf: core.Leaf, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:
    """Go through the situations in which a simple condition is true, false or unknown.

    Args:
        targets: Every target that there is.
    """
    boxes: Callable[[Any, Truth, tuple[str, ...]], Iterator[Box]] = _BOXES[type(leaf)]
    yield from boxes(leaf, truth, targets)


def _measured(leaf: Any, truth: Truth, axis: str, inside: Intervals, possible: Intervals = _ALL) -> Iterator[Box]:
    sight: Axis = ("in sight", leaf.target)
    if truth is Truth.UNKNOWN:
        yield {sight: _GONE}
    else:
        yield {sight: _SEEN, (axis, leaf.target): possible & (inside if truth is Truth.TRUE else ~inside)}


def _distance(leaf: core.DistanceCondition, truth: Truth, _targets: tuple[str, ...]) -> Iterator[Box]:
    yield from _measured(leaf, truth, leaf.quantity, interval(leaf.above_m, leaf.below_m), _LENGTHS)


def _direction(leaf: core.DirectionCondition, truth: Truth, _targets: tuple[str, ...]) -> Iterator[Box]:
    yield from _measured(leaf, truth, leaf.quantity, interval(leaf.above_rad, leaf.below_rad))


def _closing(leaf: core.ClosingCondition, truth: Truth, _targets: tuple[str, ...]) -> Iterator[Box]:
    yield from _measured(leaf, truth, "closing", interval(leaf.above_mps, leaf.below_mps))


def _contact(leaf: core.TimeToContactCondition, truth: Truth, _targets: tuple[str, ...]) -> Iterator[Box]:
    sight, sure = ("in sight", leaf.target), ("speed is sure", leaf.target)
    time = ("time to contact", leaf.target, leaf.contact_m)
    inside = interval(None, leaf.below_s)
    match truth:
        case Truth.TRUE:
            closing = interval(leaf.closing_min_mps, None)
            yield {sight: _SEEN, sure: _YES, time: inside, ("closing", leaf.target): closing}
        case Truth.FALSE:
            yield {sight: _SEEN, sure: _YES, time: ~inside}
            yield {sight: _SEEN, sure: _YES, ("closing", leaf.target): interval(None, leaf.closing_min_mps)}
        case _:
            yield {sight: _GONE}
            yield {sure: _NO}


def _separation(leaf: core.SeparationCondition, truth: Truth, _targets: tuple[str, ...]) -> Iterator[Box]:
    inside = interval(leaf.above_m, leaf.below_m)
    first, second = (("in sight", target) for target in leaf.targets)
    if truth is Truth.UNKNOWN:
        yield {first: _GONE}
        yield {second: _GONE}
        return
    axis = ("separation", *sorted(leaf.targets))
    yield {first: _SEEN, second: _SEEN, axis: _LENGTHS & (inside if truth is Truth.TRUE else ~inside)}


def _presence(leaf: core.PresenceCondition, truth: Truth, _targets: tuple[str, ...]) -> Iterator[Box]:
    if truth is not Truth.UNKNOWN:
        holds = interval(leaf.for_s, None) if leaf.seen else interval(None, -leaf.for_s)
        yield {("in sight", leaf.target): holds if truth is Truth.TRUE else ~holds}


def _count(leaf: core.CountCondition, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:
    if truth is not Truth.UNKNOWN:
        counted = tuple(sorted(set(leaf.targets or targets)))
        at_least = -math.inf if leaf.at_least is None else leaf.at_least - 0.5
        at_most = math.inf if leaf.at_most is None else leaf.at_most + 0.5
        holds = interval(at_least, at_most)
        # Whole numbers from none to all, each with the half before and after it.
        possible = interval(-0.5, len(counted) + 0.5)
        yield {("count", *counted): possible & (holds if truth is Truth.TRUE else ~holds)}


def _rule(leaf: core.RuleCondition, truth: Truth, _targets: tuple[str, ...]) -> Iterator[Box]:
    yield {("rule", leaf.rule): {Truth.TRUE: _YES, Truth.FALSE: _NO, Truth.UNKNOWN: _UNKNOWN}[truth]}


def _schedule(leaf: core.ScheduleCondition, truth: Truth, _targets: tuple[str, ...]) -> Iterator[Box]:
    if truth is Truth.UNKNOWN:
        yield {("clock",): _UNKNOWN}
        return
    week = week_of(leaf)
    whole_week = interval(0.0, WEEK_S)
    yield {("clock",): _YES, ("week",): whole_week & (week if truth is Truth.TRUE else ~week)}


def week_of(leaf: core.ScheduleCondition) -> Intervals:
    """Return at which seconds of the week a schedule holds."""
    length_s = leaf.to_s - leaf.from_s + (0.0 if leaf.to_s > leaf.from_s else DAY_S)
    days = leaf.weekdays or range(7)
    starts = [day * DAY_S + leaf.from_s for day in days]
    whole = [(start, start + length_s) for start in starts]
    return union_of([*whole, *((low - WEEK_S, high - WEEK_S) for low, high in whole)]) & interval(0.0, WEEK_S)


_BOXES: Mapping[type, Callable[[Any, Truth, tuple[str, ...]], Iterator[Box]]] = {
    core.DistanceCondition: _distance,
    core.DirectionCondition: _direction,
    core.ClosingCondition: _closing,
    core.TimeToContactCondition: _contact,
    core.SeparationCondition: _separation,
    core.PresenceCondition: _presence,
    core.CountCondition: _count,
    core.RuleCondition: _rule,
    core.ScheduleCondition: _schedule,
}


def is_possible(box: Box) -> bool:
    """Return whether a situation can be in a box, given what is true of every situation.

    A depth is no longer than the distance; as many targets are counted as are in sight; two targets are at most as far
    apart as both distances together, and at least as far as these differ.
    """
    return not any(part.is_empty for part in box.values()) and all(_fits(box, axis) for axis in box)


def _fits(box: Box, axis: Axis) -> bool:
    name, *names = axis
    if name == "depth":
        return box[axis].parts[0][0] < _ends(box, ("distance", *names))[1]
    if name == "count":
        sights = [box.get(("in sight", target)) for target in names]
        seen = sum(sight is not None and (sight & _GONE).is_empty for sight in sights)
        gone = sum(sight is not None and (sight & _SEEN).is_empty for sight in sights)
        return not (box[axis] & interval(seen - 0.5, len(names) - gone + 0.5)).is_empty
    if name == "separation":
        return _triangle(box, axis)
    return True


def _triangle(box: Box, axis: Axis) -> bool:
    (first_low, first_high), (second_low, second_high) = (_ends(box, ("distance", target)) for target in axis[1:])
    low, high = _ends(box, axis)
    return low < first_high + second_high and high > max(first_low - second_high, second_low - first_high)


def _ends(box: Box, axis: Axis) -> tuple[float, float]:
    parts = box[axis].parts if axis in box else ((0.0, math.inf),)
    return parts[0][0], parts[-1][1]
