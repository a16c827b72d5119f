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
    for name, values in chart.series.items():
        method, _, what = name.partition(", ")
        known = [each for each in zip(values, places, strict=True) if math.isfinite(each[0]) and each[0] > 0]
        if known:
            how = {"color": COLOURS[method], "label": name, "markersize": 7, "markeredgewidth": 2}
            axes.plot(*zip(*known, strict=True), MARKS[what], **how)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(mpl.ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_yticks(places, chart.rows)
    axes.invert_yaxis()
    axes.grid(axis="x", color="#dddddd")
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.set_xlabel(chart.axis)
    axes.set_title(chart.title, loc="left")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    path = folder / f"{chart.name}.svg"
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
    return path
