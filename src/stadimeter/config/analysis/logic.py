"""Whether conditions can hold together: a search through the situations in which their parts do.

What cannot be known is neither true nor false, so that a goal may be any of four: true, false, not true (false or
unknown) and not false.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum

from stadimeter.config.analysis.situations import Box, Truth, is_possible, situations
from stadimeter.core.condition import AllOf, AnyOf, Condition, Leaf, Not

STEPS = 60_000
"""How many boxes one analysis may look at: some seconds on a small computer. A configuration that people write needs
some hundreds; beyond the limit everything counts as possible, so that nothing wrong is said."""


class Wanted(Enum):
    """What a condition is to be."""

    TRUE = (Truth.TRUE,)
    FALSE = (Truth.FALSE,)
    NOT_TRUE = (Truth.FALSE, Truth.UNKNOWN)
    NOT_FALSE = (Truth.TRUE, Truth.UNKNOWN)


_OPPOSITE = {
    Wanted.TRUE: Wanted.FALSE,
    Wanted.FALSE: Wanted.TRUE,
    Wanted.NOT_TRUE: Wanted.NOT_FALSE,
    Wanted.NOT_FALSE: Wanted.NOT_TRUE,
}
_OF_EACH = {AllOf: (Wanted.TRUE, Wanted.NOT_FALSE), AnyOf: (Wanted.FALSE, Wanted.NOT_TRUE)}
"""What is so of the whole only when it is so of each part; everything else is, when it is so of one part."""

Goal = tuple[Condition, Wanted]
_Goals = tuple[Goal, "_Goals"] | None
"""The goals that are left: the first, and those after it. A chain is not copied when a goal is put before it."""


@dataclass(slots=True, kw_only=True)
class Logic:
    """Answers which conditions can hold together.

    Attributes:
        targets: Every target that there is.
        steps_left: How many boxes may still be looked at.
    """

    targets: tuple[str, ...]
    steps_left: int = field(default=STEPS)

    def can_be(self, *goals: Goal) -> bool:
        """Return whether there is a situation in which every goal is met.

        Returns:
            False if there surely is none.
        """
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
            case AllOf() | AnyOf() if wanted in _OF_EACH[type(condition)]:
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
