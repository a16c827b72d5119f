"""One row of the table of goals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

Facts = dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """A row of the table.

    Attributes:
        what: What is measured.
        reach: What was asked for, in words.
        facts: The names of the figures.
        limits: The least or greatest value of each figure, in its own unit.
        most: Whether the limits are the greatest values; else the least.
        show: How to write a figure.
    """

    what: str
    reach: str
    facts: Sequence[str]
    limits: Sequence[float]
    most: bool
    show: Callable[[float], str]

    def line(self, facts: Facts) -> tuple[str, str, str, str]:
        """Return what, what was asked for, what was reached, and whether that is enough."""
        values = [facts.get(name, math.nan) for name in self.facts]
        if all(math.isnan(value) for value in values):
            return self.what, self.reach, "not measured", "–"
        reached = " / ".join("–" if math.isnan(value) else self.show(value) for value in values)
        pairs = zip(values, self.limits, strict=True)
        held = all(value <= limit if self.most else value >= limit for value, limit in pairs)
        return self.what, self.reach, reached, "yes" if held else "**no**"


def percent(value: float) -> str:
    """Write a share."""
    return f"{100 * value:.2f} %"


def times(value: float) -> str:
    """Write a factor."""
    return f"{value:.1f} ×"
