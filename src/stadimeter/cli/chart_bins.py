"""From distances at any moments to one stretch of distances for each column of a chart."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from stadimeter.cli.run_history import Sample

JOIN_S = 1.0
"""Distances further apart than this are not joined: the loop stood still, and nothing is known of the time between."""

FARTHEST_M = 1e5
"""No camera measures further than this; such a figure would only squeeze all others together."""


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
    """What one column shows: the distances of its time, and the band of their standard deviations."""

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


def binned(samples: Iterable[Sample], bin_s: float) -> dict[int, Bin]:
    """Sort distances into columns of time.

    Columns are fixed in time, so what was drawn once moves to the left but never changes its shape.

    Args:
        samples: The distances, oldest first. One without a distance makes a gap.
        bin_s: How much time a column stands for.

    Returns:
        The columns that show something, by the number of `bin_s` since time 0.
    """
    bins: dict[int, Bin] = {}
    for run in _runs(samples):
        before: Point | None = None
        for point in _dense(run, bin_s):
            index = math.floor(point.at_s / bin_s)
            if before is not None and index not in bins:
                bins.setdefault(index, Bin()).add(before)  # so that a step is drawn as a line, not as two dots
            bins.setdefault(index, Bin()).add(point)
            before = point
    return bins


def _runs(samples: Iterable[Sample]) -> Iterator[list[Point]]:
    """Split distances where there is a gap."""
    run: list[Point] = []
    for sample in samples:
        point = known_point(sample)
        if run and (point is None or point.at_s - run[-1].at_s > JOIN_S):
            yield run
            run = []
        if point is not None:
            run.append(point)
    if run:
        yield run


def known_point(sample: Sample) -> Point | None:
    """Return a sample as a point to draw.

    Args:
        sample: The sample.

    Returns:
        The point; None if it holds no distance that can be drawn. Its standard deviation is at most the distance, so
        that the band never reaches below zero nor far above everything else.
    """
    distance_m, sigma_m = sample.distance_m, sample.sigma_m
    if distance_m is None or not 0 <= distance_m <= FARTHEST_M:
        return None
    return Point(at_s=sample.at_s, distance_m=distance_m, sigma_m=min(sigma_m, distance_m) if sigma_m > 0 else 0.0)


def _dense(run: Sequence[Point], bin_s: float) -> Iterator[Point]:
    """Fill up with points on the straight line between two, so that no column of a run stays empty."""
    yield run[0]
    for one, other in pairwise(run):
        steps = max(1, math.ceil((other.at_s - one.at_s) / bin_s))
        for step in range(1, steps):
            yield _mixed(one, other, step / steps)
        yield other


def _mixed(one: Point, other: Point, share: float) -> Point:
    return Point(
        at_s=one.at_s + share * (other.at_s - one.at_s),
        distance_m=one.distance_m + share * (other.distance_m - one.distance_m),
        sigma_m=one.sigma_m + share * (other.sigma_m - one.sigma_m),
    )
