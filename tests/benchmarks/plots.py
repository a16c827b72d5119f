"""Draws the charts. The same figures give the same files, byte for byte."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
from part import Chart

mpl.use("Agg")
mpl.rcParams["svg.hashsalt"] = "stadimeter"
mpl.rcParams["svg.fonttype"] = "none"

from matplotlib import pyplot as plt  # noqa: E402  # the backend is chosen first

COLOURS = {"stadimeter": "#0b6e4f", "tutorial": "#c8553d"}
OTHERS = ("#3d5a80", "#98c1d9", "#8a6fa8", "#b08900")
MARKS = {"median": "o", "p95": "|"}
ROW_INCHES = 0.27


def draw_chart(chart: Chart, folder: Path) -> Path:
    """Draw a chart.

    Args:
        chart: What to draw.
        folder: Where its file goes.

    Returns:
        The path of the file.
    """
    figure, axes = plt.subplots(figsize=(8, 1.4 + ROW_INCHES * len(chart.rows)), layout="constrained")
    places = range(len(chart.rows))
    if chart.band:
        axes.axvspan(*chart.band, color="#0b6e4f", alpha=0.12, linewidth=0)
    for number, (name, values) in enumerate(chart.series.items()):
        method, _, what = name.partition(", ")
        colour = COLOURS.get(method, OTHERS[number % len(OTHERS)])
        known = [(value, place) for value, place in zip(values, places, strict=True) if _can_be_shown(value, chart)]
        if known:
            axes.plot(
                *zip(*known, strict=True),
                MARKS.get(what, "o"),
                color=colour,
                label=name,
                markersize=7,
                markeredgewidth=2,
            )
    if chart.is_logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(mpl.ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_yticks(places, chart.rows)
    axes.invert_yaxis()
    axes.grid(axis="x", color="#dddddd")
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.set_xlabel(chart.axis)
    axes.set_title(chart.title, loc="left")
    if len(chart.series) > 1:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    path = folder / f"{chart.name}.svg"
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
    return path


def _can_be_shown(value: float, chart: Chart) -> bool:
    return math.isfinite(value) and (value > 0 or not chart.is_logarithmic)
