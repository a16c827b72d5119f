"""What was to be reached, and what was: real pictures first, then rendered ones, then time."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct
from part import row, table

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


def _stated_goals() -> dict[str, tuple[Goal, ...]]:
    """Return the goals by group. `goals.toml` says how they are written."""
    groups = tomllib.loads(Path(__file__).with_name("goals.toml").read_text(encoding="utf-8"))
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


GROUPS = _stated_goals()
GOALS = tuple(goal for group in GROUPS.values() for goal in group)
WITH_COVERAGE = {f"{part} coverage" for part in ("ball", "sheet", "disc", "tag")}
"""Of every part whose intervals the last two lines tell of, a figure that it has."""


def goals_table(facts: Facts) -> str:
    """Return the table of goals, with how often the intervals hold at the end."""
    rows = [goal.line(facts) for goal in GOALS] + [_overall(facts), _by_trouble(facts)]
    return table(("what", "to reach", "reached", "met"), rows)


def with_new_goals(table_before: str, facts: Facts) -> str:
    """Return a table of goals with new lines for those whose every figure is measured; the others stay as they were.

    The last two are new if every part that they are of was measured.
    """
    kept = table_before.rstrip("\n")
    before = {line.removeprefix("| ").partition(" | ")[0]: line for line in kept.split("\n")}
    lines = kept.split("\n")[:4]  # the heading, and the head of the table
    for goal in GOALS:
        is_new = goal.limits.keys() <= facts.keys() or goal.what not in before
        lines.append(row(goal.line(facts)) if is_new else before[goal.what])
    for line in (_overall(facts), _by_trouble(facts)):
        lines.append(row(line) if facts.keys() >= WITH_COVERAGE or line[0] not in before else before[line[0]])
    return "\n".join(lines) + table_before[len(kept) :]


def _coverages(facts: Facts) -> dict[str, float]:
    return {name: value for name, value in facts.items() if name.endswith("coverage") and not math.isnan(value)}


def _overall(facts: Facts) -> tuple[str, str, str, str]:
    totals = {name: value for name, value in _coverages(facts).items() if len(name.split()) == 2}
    what, reach = "95 % interval holds the truth, overall", "93–97 %"
    if not totals:
        return what, reach, "not measured", "–"
    reached = ", ".join(f"{name.split()[0]} {100 * value:.1f} %" for name, value in totals.items())
    return what, reach, reached, "yes" if all(0.93 <= value <= 0.97 for value in totals.values()) else "**no**"


def _by_trouble(facts: Facts) -> tuple[str, str, str, str]:
    each = {name: value for name, value in _coverages(facts).items() if len(name.split()) > 2}
    what, reach = "95 % interval holds the truth, for each trouble", "90–99 %"
    if not each:
        return what, reach, "not measured", "–"
    outside = [name for name, value in each.items() if not 0.90 <= value <= 0.99]
    span = f"{100 * min(each.values()):.0f}–{100 * max(each.values()):.0f} %"
    detail = f"; outside: {', '.join(name.removesuffix(' coverage') for name in outside)}" if outside else ""
    return what, reach, span + detail, "**no**" if outside else "yes"
