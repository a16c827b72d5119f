"""A strip chart in a terminal: the distance over the last half minute, with its standard deviation as a band."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from rich.text import Text

from stadimeter.cli.chart_bins import Bin, binned, known_point
from stadimeter.cli.chart_scale import ChartScale, chart_scale
from stadimeter.cli.dot_canvas import DotCanvas, Layer
from stadimeter.cli.formatting import METRE, LengthUnit
from stadimeter.cli.glyphs import UNICODE, Glyphs
from stadimeter.cli.run_history import WINDOW_S, Sample

BAND = Layer(style="blue", character=":")
LIMIT = Layer(style="yellow", character="-")
LINE = Layer(style="bright_cyan", character="*")

SPAN_MIN_M = 0.4
"""The scale spans at least this much, so that the noise of a target at rest looks like rest."""

PLOT_WIDTH_MIN = 12
"""In fewer columns nothing can be read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StripChart:
    """How a strip chart looks.

    Attributes:
        width: Its columns, axis and labels included.
        height: Its rows, the axis of time included; below 3 nothing can be drawn.
        unit: The unit of the vertical axis.
        limits_m: Distances to draw as dotted lines.
        window_s: How much time it shows.
        glyphs: The characters to draw with.
    """

    width: int
    height: int
    unit: LengthUnit = METRE
    limits_m: tuple[float, ...] = ()
    window_s: float = WINDOW_S
    glyphs: Glyphs = UNICODE

    def render(self, samples: Sequence[Sample], now_s: float) -> list[Text]:
        """Draw the chart.

        Args:
            samples: The distances, oldest first. One without a distance makes a gap.
            now_s: The time at the right edge, on the clock of the samples.

        Returns:
            The rows, each of `width` columns at most; fewer than `height`, or none, where there is no room.
        """
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
        self._draw_samples(canvas, scale, binned(samples, bin_s), canvas.width_dots - 1 - math.floor(now_s / bin_s))
        plot = [self._with_axis(label, margin - 2, row) for label, row in zip(labels, canvas.rows(), strict=True)]
        return [*plot, self._time_axis(margin, self.width - margin)]

    def _scale(self, samples: Iterable[Sample], rows: int) -> ChartScale:
        points = [point for sample in samples if (point := known_point(sample))]
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
