"""A strip chart in a terminal: the distance over the last half minute, with its standard deviation as a band."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from rich.text import Text

from stadimeter.app.live.history import DistanceSample
from stadimeter.cli.formatting import METRE, LengthUnit
from stadimeter.cli.glyphs import UNICODE, Glyphs


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """One kind of thing that is drawn: the colour of cells where it is on top, and its character in ASCII."""

    style: str
    character: str


BAND = Layer(style="blue", character=":")
LIMIT = Layer(style="yellow", character="-")
LINE = Layer(style="bright_cyan", character="*")

# A chart shows this long.
WINDOW_S = 30.0

# The scale spans at least this much, so that the noise of a target at rest looks like rest.
SPAN_MIN_M = 0.4

# In fewer columns nothing can be read.
PLOT_WIDTH_MIN = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class StripChart:
    """A chart of distance over time.

    Attributes:
        width: Its columns, axis and labels included.
        height: Its rows, the axis of time included; below 3 nothing can be drawn.
    """

    width: int
    height: int
    unit: LengthUnit = METRE
    limits_m: tuple[float, ...] = ()
    window_s: float = WINDOW_S
    glyphs: Glyphs = UNICODE

    def render(self, samples: Sequence[DistanceSample], now_s: float) -> list[Text]:
        """Draw the chart up to a time on the samples' clock; fewer rows, or none, where there is no room."""
        rows = self.height - 1
        if rows < 2:
            return []
        scale = self._scale(samples, rows)
        labels = self._labels(scale, rows)
        margin = max(len(label) for label in labels) + 2
        if self.width - margin < PLOT_WIDTH_MIN:
            return []
        canvas = DotCanvas(self.width - margin, rows, (BAND, LIMIT, LINE), ascii_only=self.glyphs.ascii_only)
        self._draw_limits(canvas, scale)
        bin_s = self.window_s / canvas.width_dots
        self._draw_samples(
            canvas, scale, bin_samples(samples, bin_s), canvas.width_dots - 1 - math.floor(now_s / bin_s)
        )
        plot = [self._with_axis(label, margin - 2, row) for label, row in zip(labels, canvas.rows(), strict=True)]
        return [*plot, self._time_axis(margin, self.width - margin)]

    def _scale(self, samples: Iterable[DistanceSample], rows: int) -> ChartScale:
        points = [point for sample in samples if (point := point_of(sample))]
        edges_m = [edge_m for point in points for edge_m in (point.low_m, point.high_m)]
        values = (edge_m / self.unit.size_m for edge_m in (*edges_m, *self.limits_m))
        return chart_scale(values, SPAN_MIN_M / self.unit.size_m, rows)

    def _labels(self, scale: ChartScale, rows: int) -> list[str]:
        labels = {row: f"{label} {self.unit.symbol}" for row, label in scale.labels()}
        return [labels.get(row, "") for row in range(rows)]

    def _with_axis(self, label: str, width: int, row: Text) -> Text:
        axis = self.glyphs.tick if label else self.glyphs.axis
        return Text.assemble((f"{label:>{width}} ", "dim"), (axis, "dim"), row)

    def _time_axis(self, margin: int, plot_width: int) -> Text:
        """Draw the axis below: a label every ten seconds, or at the ends alone where there is little room."""
        line = list(self.glyphs.line * plot_width)
        ages_s = range(0, int(self.window_s) + 1, 10) if plot_width >= 40 else (0, int(self.window_s))
        for age_s in ages_s:
            label = f" -{age_s} s " if age_s else " now"
            start = round((1 - age_s / self.window_s) * plot_width - len(label) / 2)
            start = min(max(start, 0), plot_width - len(label))
            line[start : start + len(label)] = label
        return Text.assemble((" " * (margin - 1) + self.glyphs.corner + "".join(line), "dim"))

    def _draw_limits(self, canvas: DotCanvas, scale: ChartScale) -> None:
        for limit_m in self.limits_m:
            row = canvas.dots_of_row(scale.position(limit_m / self.unit.size_m))
            for x in range(0, canvas.width_dots, 1 if self.glyphs.ascii_only else 3):
                canvas.dot(x, row, LIMIT)

    def _draw_samples(self, canvas: DotCanvas, scale: ChartScale, bins: Mapping[int, Bin], x_of_bin_0: int) -> None:
        def row(value_m: float) -> int:
            return canvas.dots_of_row(scale.position(value_m / self.unit.size_m))

        for index, stretch in bins.items():
            x = x_of_bin_0 + index
            for y in range(row(stretch.band_high_m), row(stretch.band_low_m) + 1):
                if self.glyphs.ascii_only or (index + y) % 2 == 0:  # half the dots, to tell it from the line
                    canvas.dot(x, y, BAND)
            for y in range(row(stretch.high_m), row(stretch.low_m) + 1):
                canvas.dot(x, y, LINE)


# The bit of each dot, by column and row in the cell, as Unicode numbers them (chapter 21.1, Braille).
BRAILLE_BLANK = 0x2800
BRAILLE_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


class DotCanvas:
    """Dots in cells. A cell has the colour of the topmost layer in it.

    Args:
        layers: All layers, lowest first.
        ascii_only: Whether a cell holds one dot, shown as the character of the layer.
    """

    def __init__(self, width: int, height: int, layers: Iterable[Layer], *, ascii_only: bool = False) -> None:
        self._layers = tuple(layers)
        self._ascii_only = ascii_only
        self._dots_across, self._dots_down = (1, 1) if ascii_only else (2, 4)
        self._width, self._height = width, height
        self._bits = [[0] * width for _ in range(height)]
        self._top = [[-1] * width for _ in range(height)]

    @property
    def width_dots(self) -> int:
        """Dots side by side."""
        return self._width * self._dots_across

    @property
    def height_dots(self) -> int:
        """Dots one above the other."""
        return self._height * self._dots_down

    def dots_of_row(self, position: float) -> int:
        """Return the row of dots nearest to a position in rows of cells, at most one outside of the canvas."""
        row = round(position * self._dots_down + (self._dots_down - 1) / 2)
        return min(max(row, -1), self.height_dots)

    def dot(self, x: int, y: int, layer: Layer) -> None:
        """Set a dot, in columns from the left and rows from the top; outside the canvas it does nothing."""
        if not (0 <= x < self.width_dots and 0 <= y < self.height_dots):
            return
        column, row = x // self._dots_across, y // self._dots_down
        self._bits[row][column] |= BRAILLE_BITS[x % self._dots_across][y % self._dots_down]
        self._top[row][column] = max(self._top[row][column], self._layers.index(layer))

    def rows(self) -> list[Text]:
        """Return the picture, one text for each row of cells."""
        return [
            Text.assemble(*(self._cell(bits, top) for bits, top in zip(bits_row, top_row, strict=True)))
            for bits_row, top_row in zip(self._bits, self._top, strict=True)
        ]

    def _cell(self, bits: int, top: int) -> tuple[str, str]:
        if top < 0:
            return " ", ""  # not the blank of braille: some fonts draw circles for it
        layer = self._layers[top]
        return (layer.character if self._ascii_only else chr(BRAILLE_BLANK + bits)), layer.style


# With few rows a step that is too large wastes half of them, so less round ones are taken too.
FACTORS = (1, 2, 5)
FINE_FACTORS = (1, 2, 3, 4, 5, 6, 8)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartScale:
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
        """Return how many rows below the middle of the top row a figure is; not within the rows if off the scale."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A distance that is known."""

    at_s: float
    distance_m: float
    sigma_m: float

    @property
    def low_m(self) -> float:
        """The lower edge of the band."""
        return self.distance_m - self.sigma_m

    @property
    def high_m(self) -> float:
        """The upper edge of the band."""
        return self.distance_m + self.sigma_m


@dataclass(slots=True, kw_only=True)
class Bin:
    """One column: the distances of its time, and the band of their standard deviations."""

    low_m: float = math.inf
    high_m: float = -math.inf
    band_low_m: float = math.inf
    band_high_m: float = -math.inf

    def add(self, point: Point) -> None:
        """Stretch to hold a point."""
        self.low_m = min(self.low_m, point.distance_m)
        self.high_m = max(self.high_m, point.distance_m)
        self.band_low_m = min(self.band_low_m, point.low_m)
        self.band_high_m = max(self.band_high_m, point.high_m)


def bin_samples(samples: Iterable[DistanceSample], bin_s: float) -> dict[int, Bin]:
    """Sort distances, oldest first, into columns of time, by the number of `bin_s` since time 0.

    Columns are fixed in time, so what was drawn once moves to the left but never changes its shape. A sample without a
    distance makes a gap.
    """
    bins: dict[int, Bin] = {}
    for run in _runs(samples):
        before: Point | None = None
        for point in _densify(run, bin_s):
            index = math.floor(point.at_s / bin_s)
            if before is not None and index not in bins:
                bins.setdefault(index, Bin()).add(before)  # so that a step is drawn as a line, not as two dots
            bins.setdefault(index, Bin()).add(point)
            before = point
    return bins


def _runs(samples: Iterable[DistanceSample]) -> Iterator[list[Point]]:
    """Split distances where there is a gap."""
    run: list[Point] = []
    for sample in samples:
        point = point_of(sample)
        if run and (point is None or point.at_s - run[-1].at_s > JOIN_S):
            yield run
            run = []
        if point is not None:
            run.append(point)
    if run:
        yield run


def point_of(sample: DistanceSample) -> Point | None:
    """Return a sample as a point to draw; None if it holds no distance that can be drawn.

    Its standard deviation is at most the distance, so that the band never reaches below zero, nor far above all else.
    """
    distance_m, sigma_m = sample.distance_m, sample.sigma_m
    if distance_m is None or not 0 <= distance_m <= MAX_DISTANCE_M:
        return None
    return Point(at_s=sample.at_s, distance_m=distance_m, sigma_m=min(sigma_m, distance_m) if sigma_m > 0 else 0.0)


def _densify(run: Sequence[Point], bin_s: float) -> Iterator[Point]:
    """Fill up with points on the straight line between two, so that no column of a run stays empty."""
    yield run[0]
    for one, other in pairwise(run):
        steps = max(1, math.ceil((other.at_s - one.at_s) / bin_s))
        for step in range(1, steps):
            yield _interpolate(one, other, step / steps)
        yield other


def _interpolate(one: Point, other: Point, share: float) -> Point:
    return Point(
        at_s=one.at_s + share * (other.at_s - one.at_s),
        distance_m=one.distance_m + share * (other.distance_m - one.distance_m),
        sigma_m=one.sigma_m + share * (other.sigma_m - one.sigma_m),
    )
