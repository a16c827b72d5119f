"""The rows of a table of goals, and the files that state them."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

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


def goals_of(name: str) -> dict[str, tuple[Goal, ...]]:
    """Return the goals that a file of this folder states, by group. `goals.toml` says how they are written."""
    groups = tomllib.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))
    return {group: tuple(_goal(**row) for row in rows) for group, rows in groups.items()}


def _goal(what: str, reach: str, show: str = "percent", **bounds: dict[str, Any]) -> Goal:
    limits = {figure: (-math.inf, limit) for figure, limit in bounds.get("most", {}).items()}
    limits |= {figure: (limit, math.inf) for figure, limit in bounds.get("least", {}).items()}
    limits |= {figure: (least, most) for figure, (least, most) in bounds.get("between", {}).items()}
    return Goal(what, reach, _show(show), limits)


def _show(words: str) -> Show:
    """Return how to write a figure: as a share, as a factor, or with so many digits after the point and a unit."""
    if words == "percent":
        return lambda value: f"{100 * value:.2f} %"
    if words == "times":
        return lambda value: f"{value:.1f} ×"
    digits, _, unit = words.partition(" ")
    return lambda value: f"{value:.{int(digits)}f} {unit}".rstrip()
