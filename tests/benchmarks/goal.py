"""One row of the table of goals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from msgspec import Struct

Facts = dict[str, float]
Show = Callable[[float], str]
"""How to write a figure."""


class Goal(Struct, frozen=True):
    """A row of the table.

    Attributes:
        what: What is measured.
        reach: What was asked for, in words.
        show: How to write a figure.
        limits: The least and the greatest value of each figure, by its name, in its own unit.
    """

    what: str
    reach: str
    show: Show
    limits: Mapping[str, tuple[float, float]]

    def line(self, facts: Facts) -> tuple[str, str, str, str]:
        """Return what, what was asked for, what was reached, and whether that is enough."""
        values = {name: facts.get(name, math.nan) for name in self.limits}
        if all(math.isnan(value) for value in values.values()):
            return self.what, self.reach, "not measured", "–"
        reached = " / ".join("–" if math.isnan(value) else self.show(value) for value in values.values())
        held = all(least <= values[name] <= most for name, (least, most) in self.limits.items())
        return self.what, self.reach, reached, "yes" if held else "**no**"


def at_least(what: str, reach: str, show: Show, limits: Mapping[str, float]) -> Goal:
    """Return a goal whose figures are to be as great as this, or greater."""
    return Goal(what, reach, show, {name: (limit, math.inf) for name, limit in limits.items()})


def at_most(what: str, reach: str, show: Show, limits: Mapping[str, float]) -> Goal:
    """Return a goal whose figures are to be as small as this, or smaller."""
    return Goal(what, reach, show, {name: (-math.inf, limit) for name, limit in limits.items()})


def percent(value: float) -> str:
    """Write a share."""
    return f"{100 * value:.2f} %"


def times(value: float) -> str:
    """Write a factor."""
    return f"{value:.1f} ×"


def plain(digits: int, unit: str = "") -> Show:
    """Return how to write a figure with so many digits after the point, and its unit."""
    return lambda value: f"{value:.{digits}f}{unit and ' '}{unit}"
