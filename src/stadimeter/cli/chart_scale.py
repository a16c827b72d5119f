"""The vertical scale of a chart: round figures, evenly spaced, each exactly at the middle of a row of characters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

FACTORS = (1, 2, 5)
FINE_FACTORS = (1, 2, 3, 4, 5, 6, 8)
"""With few rows a step that is too large wastes half of them, so less round ones are taken too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartScale:
    """A scale over rows of characters.

    Attributes:
        low: The figure at the bottom row, in the unit that is shown.
        step: From one label to the next, in the same unit.
        rows: How many rows there are.
        rows_per_step: How many rows apart labels are.
    """

    low: float
    step: float
    rows: int
    rows_per_step: int

    def position(self, value: float) -> float:
        """Return how many rows below the top row a figure is.

        Args:
            value: The figure, in the unit that is shown.

        Returns:
            0 at the middle of the top row, ``rows - 1`` at the middle of the bottom row, and outside of these for
            figures that are not on the scale.
        """
        return self.rows - 1 - (value - self.low) / self.step * self.rows_per_step

    def labels(self) -> Iterator[tuple[int, str]]:
        """Yield each label with its row, counted from the top."""
        decimals = max(0, -math.floor(math.log10(self.step) + 1e-9))
        for number, row in enumerate(range(self.rows - 1, -1, -self.rows_per_step)):
            yield row, f"{self.low + number * self.step:.{decimals}f}"


def chart_scale(values: Iterable[float], span_min: float, rows: int) -> ChartScale:
    """Choose a scale that holds all figures and does not wobble with every new one.

    Args:
        values: The figures to show, finite; without any, the scale begins at 0.
        span_min: The scale spans at least this much, so that noise does not fill it.
        rows: How many rows of characters there are, two or more.

    Returns:
        The scale. It never goes below 0, for it is for distances.
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
