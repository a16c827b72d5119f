"""Sets of real numbers as unions of intervals, and sets of situations as boxes of them.

Ends do not count: no measurement is exactly at a threshold.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any


@dataclass(frozen=True, slots=True)
class Intervals:
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


Axis = tuple[Any, ...]
"""Such as ``("distance", "ball")``. The axis ``("in sight", TARGET)`` is for how many seconds the target has been in
sight, and below zero for how many it has been lost."""

Box = Mapping[Axis, Intervals]
"""A set of situations: for each axis a union of intervals. Axes that it does not name are free."""

YES, NO, NOT_KNOWN = interval(0.0, 1.0), interval(-1.0, 0.0), interval(1.0, 2.0)
"""Answers, as intervals on an axis of their own."""
SEEN, GONE = interval(0.0, None), interval(None, 0.0)
"""On the axis ``("in sight", TARGET)``."""
ALL, LENGTHS = interval(None, None), interval(0.0, None)


class Truth(Enum):
    """Three-valued."""

    TRUE = "true"
    FALSE = "false"
    UNKNOWN = "unknown"
