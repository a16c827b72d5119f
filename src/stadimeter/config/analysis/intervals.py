"""Sets of real numbers, as unions of intervals. Ends do not count: no measurement is exactly at a limit."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass


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
    """Return one interval.

    Args:
        low: Its lower end; None for none.
        high: Its upper end; None for none.

    Returns:
        The interval; empty if the ends are not in order.
    """
    return union_of([(-math.inf if low is None else low, math.inf if high is None else high)])


def union_of(parts: Iterable[tuple[float, float]]) -> Intervals:
    """Return the union of intervals, which may overlap.

    Args:
        parts: The ends of each; those whose ends are not in order are empty.
    """
    merged: list[tuple[float, float]] = []
    for low, high in sorted((low, high) for low, high in parts if low < high):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return Intervals(tuple(merged))
