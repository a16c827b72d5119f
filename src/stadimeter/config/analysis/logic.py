"""Whether conditions can hold together: a search through the situations in which their parts do.

What cannot be known is neither true nor false, so that a goal may be any of four: true, false, not true (false or
unknown) and not false.

A situation says where each target is, how long it has been in sight, which rules are active, and what time it is. Each
of these is one number on an axis of its own, so a set of situations is a box: for each axis a union of intervals. With
boxes it is exact whether several conditions can hold together: no sampling, and no solver but the intersection of
intervals. See `stadimeter.config.analysis.situations` for the boxes of each kind of condition.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum

from stadimeter.config.analysis.situations import GONE, SEEN, Axis, Box, Truth, interval, situations
from stadimeter.core.condition import AllOf, AnyOf, Condition, Leaf, Not

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


@dataclass(slots=True, kw_only=True)
class Logic:
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
        seen = sum(sight is not None and (sight & GONE).is_empty for sight in sights)
        gone = sum(sight is not None and (sight & SEEN).is_empty for sight in sights)
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
