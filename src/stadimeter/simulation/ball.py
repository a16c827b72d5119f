"""The ball and how it moves."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from itertools import pairwise

from stadimeter.simulation.options import WayPoint


class Ball:
    """A ball that moves along way points.

    Between two way points each coordinate is a monotone cubic (F. N. Fritsch and J. Butland, "A method for constructing
    local monotone piecewise cubic interpolants", 1984): the speed never jumps, the ball never goes beyond its way
    points, and it stands still between two that are equal.

    Args:
        height_m: Height of its centre above the floor.
        path: Where it is when; times count from ``start_s``.
        loop: Whether it begins again at the end of its path, or stays there.
        start_s: The time on the run's clock at which the path begins.
    """

    def __init__(
        self, *, diameter_m: float, height_m: float, path: Sequence[WayPoint], loop: bool, start_s: float = 0.0
    ) -> None:
        self.diameter_m = diameter_m
        self.height_m = height_m
        self._start_s = start_s
        self._times_s = [point.at for point in path]
        self._period_s = self._times_s[-1] if loop and len(path) > 1 else None
        self._x = _Coordinate(self._times_s, [point.x for point in path], loop)
        self._y = _Coordinate(self._times_s, [point.y for point in path], loop)

    def position_m(self, time_s: float) -> tuple[float, float, float]:
        """Return where the ball's centre is: x to the east, y to the north, z up from the floor."""
        into_s = max(0.0, time_s - self._start_s)
        if self._period_s is not None:
            into_s %= self._period_s
        if into_s >= self._times_s[-1]:
            return (self._x.values[-1], self._y.values[-1], self.height_m)
        index = bisect.bisect_right(self._times_s, into_s) - 1
        return (self._x.between(index, into_s), self._y.between(index, into_s), self.height_m)


class _Coordinate:
    """One coordinate of the path: values at times, and the speed at each of them."""

    def __init__(self, times_s: list[float], values: list[float], loop: bool) -> None:
        self.values = values
        self._times_s = times_s
        self._speeds = _speeds(times_s, values, loop)

    def between(self, index: int, time_s: float) -> float:
        """Return the value at a time between way points ``index`` and the next, by a cubic Hermite curve."""
        span_s = self._times_s[index + 1] - self._times_s[index]
        share = (time_s - self._times_s[index]) / span_s
        rest = 1 - share
        return rest * rest * (
            (1 + 2 * share) * self.values[index] + share * span_s * self._speeds[index]
        ) + share * share * ((1 + 2 * rest) * self.values[index + 1] - rest * span_s * self._speeds[index + 1])


def _speeds(times_s: list[float], values: list[float], loop: bool) -> list[float]:
    """Return the speed at each way point. The path begins and ends at rest, unless it is a loop."""
    spans = [(end - begin) for begin, end in pairwise(times_s)]
    slopes = [(end - begin) / span for (begin, end), span in zip(pairwise(values), spans, strict=True)]
    inner = [_speed_between(*both) for both in zip(pairwise(spans), pairwise(slopes), strict=True)]
    ends = _speed_between((spans[-1], spans[0]), (slopes[-1], slopes[0])) if loop and spans else 0.0
    return [ends, *inner, ends] if spans else [0.0]


def _speed_between(spans: tuple[float, float], slopes: tuple[float, float]) -> float:
    """Return the weighted harmonic mean of two slopes, or 0 where the direction turns."""
    if slopes[0] * slopes[1] <= 0:
        return 0.0
    weights = (spans[0] + 2 * spans[1], 2 * spans[0] + spans[1])
    return sum(weights) / (weights[0] / slopes[0] + weights[1] / slopes[1])
