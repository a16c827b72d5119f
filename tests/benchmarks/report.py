"""The report: its head, the goals, and the parts, each of which names the commit that it was measured at."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from goals import goals_table, with_new_goals
from part import Part, commit

from support.scenes import draw

REPORT = "report.md"
SECTION = "\n## "
REAL = "real ball median"
"""A figure that is there once real pictures were measured."""


def write_report(parts: Sequence[Part], folder: Path, took_s: float, *, plots: bool) -> Path:
    """Write the report and its charts.

    Args:
        parts: What it consists of.
        folder: Where it goes.
        took_s: How long the measurements took.
        plots: Whether charts are drawn too.

    Returns:
        The path of the report.
    """
    folder.mkdir(parents=True, exist_ok=True)
    facts, measured = facts_of(parts), commit()  # before the first chart changes a file that is kept
    sections = [f"Goals\n\n{goals_table(facts)}", *(_section(part, folder, measured, plots=plots) for part in parts)]
    path = folder / REPORT
    path.write_text(SECTION.join([_head(facts, took_s, measured), *sections]), encoding="utf-8")
    return path


def replace_parts(parts: Sequence[Part], folder: Path, *, plots: bool) -> None:
    """Put parts into a report in place of what was there, new ones at its end, and the goals that they say all of."""
    path, facts, measured = folder / REPORT, facts_of(parts), commit()
    head, goals, *others = path.read_text(encoding="utf-8").split(SECTION)
    sections = {each.partition("\n")[0]: each for each in others}
    for part in parts:
        sections[part.title] = _section(part, folder, measured, plots=plots)
    if REAL in facts:
        head = re.sub(r"^\*\*On real pictures:.*\n\n", lambda _found: _real_pictures(facts), head, flags=re.MULTILINE)
    path.write_text(SECTION.join([head, with_new_goals(goals, facts), *sections.values()]), encoding="utf-8")


def _section(part: Part, folder: Path, measured: str, *, plots: bool) -> str:
    text = f"{part.title}\n\nMeasured at commit {measured}.\n\n{part.text}"
    if plots:
        from plots import draw_chart  # without charts, matplotlib is not needed

        text += "".join(f"\n![{chart.title}]({draw_chart(chart, folder).name})\n" for chart in part.charts)
    return text


def _real_pictures(facts: dict[str, float]) -> str:
    """Say on which real pictures the figures are how good, and where they are not."""
    if REAL not in facts:
        return "No real pictures were on the machine that made this report.\n\n"
    told = {name: f"{100 * value:.2f} %" for name, value in facts.items() if name.startswith("real")}
    return (
        "**On real pictures:** a tennis ball on a plain mat, taped at 32 places, is measured with a median error of "
        f"{told['real ball median']} (90 % of them within {told['real ball p90']}), though the stated interval holds "
        f"only {told['real ball held']} of them; a sheet of letter paper on a door within {told['real sheet worst']}, "
        f"as well as its tape is known; twelve AprilTags within {told['real visp median']} of computed poses. "
        "Not so good: a striped ball that a hand waves about, on video: "
        f"{facts['real video tracked']:.0f} of 1004 frames are tracked (the ball is whole in 837), "
        f"{told['real video wrong']} of its measurements are wrong by more than 8 %, and errors are "
        f"{facts['real video quantile']:.1f} times the stated noise. Balls on carpets and tape cut by hand are "
        "measured on rendered pictures only, below: there are no real ones here.\n\n"
    )


def _head(facts: dict[str, float], took_s: float, measured: str) -> str:
    return (
        "# Benchmarks\n\n"
        f"{_real_pictures(facts)}"
        "Made by `make bench`; do not edit. The pictures are rendered with exact truth by "
        "`support.scenes`: ray-cast, anti-aliased, mixed in linear light, point spread 0.7 px, sRGB, "
        f"noise 2 unless a row says otherwise. Their seeds start at {draw.REPORT_SEEDS.start}; nothing was tuned on "
        f"them: thresholds and constants were chosen on seeds below {draw.TUNING_SEEDS.stop}.\n\n"
        "Bias is the median of the signed error in pixels of apparent size: above zero the target was measured too "
        "large, so too near. The 95 % interval is ± 1.96 of the standard deviation that came with the measurement.\n\n"
        f"This run: commit {measured}, {took_s / 60:.0f} min on {os.cpu_count()} cores of {platform.machine()}, "
        f"Python {platform.python_version()}, OpenCV {cv2.__version__}, numpy {np.__version__}.\n"
    )


def facts_of(parts: Sequence[Part]) -> dict[str, float]:
    return {name: value for part in parts for name, value in part.facts.items()}
