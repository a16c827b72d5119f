"""A part of the report: text, charts, and the figures that the goals are judged by."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct, field


class Chart(Struct, frozen=True, kw_only=True):
    """What to plot: a dot for each row and series, on a logarithmic axis.

    Attributes:
        name: The name of its file, without folder and ending.
        title: What it shows.
        axis: What the figures are, with their unit.
        rows: From top to bottom.
        series: The figures of each series, as many as rows; NaN for none.
    """

    name: str
    title: str
    axis: str
    rows: Sequence[str]
    series: dict[str, Sequence[float]]


class Part(Struct, frozen=True, kw_only=True):
    """A part of the report.

    Attributes:
        title: Its heading.
        text: Markdown.
        charts: What to plot below.
        facts: Figures by name, for the goals.
    """

    title: str
    text: str
    charts: Sequence[Chart] = ()
    facts: dict[str, float] = field(default_factory=dict)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table; all columns but the first are aligned to the right."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(row(line) for line in lines) + "\n"


def row(cells: Sequence[str]) -> str:
    """Return a row of such a table."""
    return "| " + " | ".join(cells) + " |"


def commit() -> str:
    """Return the commit that is measured, with a mark if there are changes that are not in it."""
    try:
        words = ["git", "describe", "--always", "--dirty", "--abbrev=10"]
        return subprocess.run(
            words, capture_output=True, text=True, check=True, cwd=Path(__file__).parent
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
