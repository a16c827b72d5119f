"""A strip chart in a terminal: the distance over the last half minute, with its standard deviation as a band."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from rich.text import Text

from stadimeter.app.live.history import DistanceSample
from stadimeter.cli.formatting import METRE, LengthUnit

# The colours of the band, of limits and of the line. A cell has that of the highest number among its dots; 0 is no dot.
BAND, LIMIT, LINE = 1, 2, 3
STYLES = ("", "blue", "yellow", "bright_cyan")

# A chart shows this long.
WINDOW_S = 30.0

# The scale spans at least this much, so that the noise of a target at rest looks like rest.
SPAN_MIN_M = 0.4

# In fewer columns nothing can be read.
PLOT_WIDTH_MIN = 12


class StripChart(Struct, frozen=True, kw_only=True):
    """A chart of distance over time.

    Attributes:
        width: Its columns, axis and labels included.
        height: Its rows, the axis of time included; below 3 nothing can be drawn.
    """

    width: int
    height: int
    unit: LengthUnit = METRE
    limits_m: tuple[float, ...] = ()

    def render(self, samples: Iterable[DistanceSample], now_s: float) -> list[Text]:
        """Draw the chart up to a time on the samples' clock; fewer rows, or none, where there is no room."""
        rows = self.height - 1
        if rows < 2:
            return []
        runs = [np.array(run).T for run in _split_at_gaps(samples)]
        scale = self._scale(runs, rows)
        labels = {row: f"{label} {self.unit.symbol}" for row, label in scale.labels()}
        margin = max(map(len, labels.values())) + 2
        if self.width - margin < PLOT_WIDTH_MIN:
            return []
        dots: NDArray[np.intp] = np.zeros((rows * DOWN, (self.width - margin) * ACROSS), np.intp)
        self._draw(dots, scale, runs, now_s)
        plot = [
            Text.assemble(
                (f"{labels.get(row, ''):>{margin - 2}} ", "dim"),
                ("┤" if row in labels else "│", "dim"),
                *cells,
            )
            for row, cells in enumerate(_cells(dots))
        ]
        return [*plot, self._time_axis(margin, self.width - margin)]

    def _scale(self, runs: Sequence[NDArray[np.float64]], rows: int) -> ChartScale:
        edges_m = [edge_m for _, away_m, sigma_m in runs for edge_m in (*(away_m - sigma_m), *(away_m + sigma_m))]
        values = (float(edge_m) / self.unit.size_m for edge_m in (*edges_m, *self.limits_m))
        return chart_scale(values, SPAN_MIN_M / self.unit.size_m, rows)

    def _time_axis(self, margin: int, plot_width: int) -> Text:
        """Draw the axis below: a label every ten seconds, or at the ends alone where there is little room."""
        line = list("─" * plot_width)
        ages_s = range(0, int(WINDOW_S) + 1, 10) if plot_width >= 40 else (0, int(WINDOW_S))
        for age_s in ages_s:
            label = f" -{age_s} s " if age_s else " now"
            start = round((1 - age_s / WINDOW_S) * plot_width - len(label) / 2)
            start = min(max(start, 0), plot_width - len(label))
            line[start : start + len(label)] = label
        return Text.assemble((" " * (margin - 1) + "└" + "".join(line), "dim"))

    def _draw(
        self, dots: NDArray[np.intp], scale: ChartScale, runs: Iterable[NDArray[np.float64]], now_s: float
    ) -> None:
        """Set the dots of everything, in columns from the left and rows from the top."""
        height, width = dots.shape

        def row(value_m: float) -> int:
            """Return the row of dots nearest to a distance, at most one outside of the chart."""
            nearest = round(scale.position(value_m / self.unit.size_m) * DOWN + (DOWN - 1) / 2)
            clipped: int = min(max(nearest, -1), height)
            return clipped

        column_s = WINDOW_S / width
        x_of_column_0 = width - 1 - math.floor(now_s / column_s)
        for column, points in sort_into_columns(runs, column_s).items():
            if not 0 <= (x := x_of_column_0 + column) < width:
                continue
            top = max(0, row(max(distance_m + sigma_m for distance_m, sigma_m in points)))
            bottom = row(min(distance_m - sigma_m for distance_m, sigma_m in points))
            dots[top + (column + top) % 2 : bottom + 1 : 2, x] = BAND  # half the dots, to tell it from the line
            distances_m = [distance_m for distance_m, _ in points]
            dots[max(0, row(max(distances_m))) : row(min(distances_m)) + 1, x] = LINE
        for limit_m in self.limits_m:
            if 0 <= (y := row(limit_m)) < height:
                dots[y, ::3] = np.maximum(dots[y, ::3], LIMIT)


# The dots of a cell, and the bit of each, by row and column, as Unicode numbers them (chapter 21.1, Braille).
ACROSS, DOWN = 2, 4
BRAILLE_BLANK = 0x2800
BRAILLE_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])


def _cells(dots: NDArray[np.intp]) -> Iterator[list[tuple[str, str]]]:
    """Yield the cells of each row, each a character and its style."""
    height, width = dots.shape
    cells = dots.reshape(height // DOWN, DOWN, width // ACROSS, ACROSS).swapaxes(1, 2)
    bits = ((cells > 0) * BRAILLE_BITS).sum((2, 3))
    for row_of_bits, row_of_tops in zip(bits.tolist(), cells.max((2, 3)).tolist(), strict=True):
        yield [
            (chr(BRAILLE_BLANK + bits) if bits else " ", STYLES[top])  # some fonts draw circles for the blank
            for bits, top in zip(row_of_bits, row_of_tops, strict=True)
        ]


# With few rows a step that is too large wastes half of them, so less round ones are taken too.
FACTORS = (1, 2, 5)
FINE_FACTORS = (1, 2, 3, 4, 5, 6, 8)


class ChartScale(Struct, frozen=True, kw_only=True):
    """A scale over rows of characters.

    Attributes:
        low: The figure at the bottom row, in the unit that is shown.
        step: From one label to the next, in the same unit.
    """

    low: float
    step: float
    rows: int
    rows_per_step: int

    def position(self, value: float) -> float:
        """Return the rows a figure is below the middle of the top row; not within the rows if off the scale."""
        return self.rows - 1 - (value - self.low) / self.step * self.rows_per_step

    def labels(self) -> Iterator[tuple[int, str]]:
        """Yield each label with its row, counted from the top."""
        decimals = max(0, -math.floor(math.log10(self.step) + 1e-9))
        for number, row in enumerate(range(self.rows - 1, -1, -self.rows_per_step)):
            yield row, f"{self.low + number * self.step:.{decimals}f}"


def chart_scale(values: Iterable[float], span_min: float, rows: int) -> ChartScale:
    """Choose a scale that holds all figures and does not wobble with every new one; it never goes below 0.

    Args:
        values: Finite; without any, the scale begins at 0.
        span_min: The scale spans at least this much, so that noise does not fill it.
        rows: Two or more.
    """
    shown = [max(0.0, value) for value in values] or [0.0]
    lowest, highest = min(shown), max(shown)
    missing = max(0.0, span_min - (highest - lowest)) / 2
    lowest, highest = max(0.0, lowest - missing), highest + missing
    steps_max = max(1, (rows - 1) // 2)  # a label in every other row is as many as can be read
    factors = FINE_FACTORS if steps_max <= 3 else FACTORS
    for step in _round_steps((highest - lowest) / steps_max, factors):
        low = math.floor(lowest / step + 1e-9) * step
        steps = max(1, math.ceil((highest - low) / step - 1e-9))
        if steps <= steps_max:
            break
    return ChartScale(low=low, step=step, rows=rows, rows_per_step=(rows - 1) // steps)


def _round_steps(least: float, factors: tuple[int, ...]) -> Iterator[float]:
    """Yield some multiples of the powers of ten, upwards from ``least``."""
    power = math.floor(math.log10(least))
    while True:
        for factor in factors:
            if (step := factor * 10.0**power) >= least * (1 - 1e-9):
                yield step
        power += 1


# Distances further apart than this are not joined: the loop stood still, and nothing is known of the time between.
JOIN_S = 1.0

# No camera measures further than this; such a figure would only squeeze all others together.
MAX_DISTANCE_M = 1e5


def _split_at_gaps(samples: Iterable[DistanceSample]) -> Iterator[list[tuple[float, float, float]]]:
    """Yield runs of times, distances and standard deviations; a sample that cannot be drawn is a gap.

    A standard deviation is at most its distance, so that the band never reaches below zero, nor far above all else.
    """
    run: list[tuple[float, float, float]] = []
    for sample in samples:
        distance_m, sigma_m = sample.distance_m, sample.sigma_m
        is_known = distance_m is not None and 0 <= distance_m <= MAX_DISTANCE_M
        if run and (not is_known or sample.at_s - run[-1][0] > JOIN_S):
            yield run
            run = []
        if distance_m is not None and is_known:
            run.append((sample.at_s, distance_m, min(sigma_m, distance_m) if sigma_m > 0 else 0.0))
    if run:
        yield run


def sort_into_columns(runs: Iterable[NDArray[np.float64]], column_s: float) -> dict[int, list[tuple[float, float]]]:
    """Return distances with their standard deviations by column of time, counted from time 0.

    Columns are fixed in time, so what was drawn once moves to the left but never changes its shape. Where the straight
    line between two distances goes from one column to the next, both have the point there: no column of a run is empty,
    and a step is a line.
    """
    columns: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for at_s, distance_m, sigma_m in runs:
        of_points = np.floor(at_s / column_s)
        borders = np.arange(of_points[0] + 1, of_points[-1] + 1)
        times_s = np.concatenate([at_s, borders * column_s, borders * column_s])
        of_each = np.concatenate([of_points, borders - 1, borders])
        points = zip(np.interp(times_s, at_s, distance_m), np.interp(times_s, at_s, sigma_m), strict=True)
        for column, point in zip(of_each.tolist(), points, strict=True):
            columns[int(column)].append(point)
    return columns
