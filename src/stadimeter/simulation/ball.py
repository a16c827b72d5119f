"""The ball of the simulated world: it rolls along way points, and a hand may take it elsewhere and let it go."""

from __future__ import annotations

import bisect
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

from pydantic import BeforeValidator

from stadimeter.config.plugins import OptionsTable
from stadimeter.config.units import LENGTHS_M, Duration, as_written, parse_quantity
from stadimeter.simulation.robot import Pose

ORIGIN = Pose(x_m=0.0, y_m=0.0, heading_rad=0.0)

# The newest beginnings of the path are remembered, for questions about a moment that has passed.
ROUNDS_MAX = 16


def parse_coordinate(text: object) -> float:
    """Read a coordinate such as ``"-1.5 m"``, return it in metres; raises ValueError if it is not a length."""
    return parse_quantity(text, LENGTHS_M, "-1.5 m")


Coordinate = Annotated[float, BeforeValidator(parse_coordinate), as_written(LENGTHS_M, "-1.5 m", is_signed=True)]


class WayPoint(OptionsTable):
    """The position of the ball at some time."""

    at: Duration
    """When, in seconds from the start of the run."""
    x: Coordinate
    """Metres to the east."""
    y: Coordinate
    """Metres to the north."""


@dataclass(frozen=True, slots=True)
class _Round:
    """The path from a time on, laid out for a robot in another pose than the one that it was made for."""

    start_s: float
    made_for: Pose
    pose: Pose

    def placed(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return where a point of the path is."""
        turn_rad = self.pose.heading_rad - self.made_for.heading_rad
        cos, sin = math.cos(turn_rad), math.sin(turn_rad)
        x_m, y_m = x_m - self.made_for.x_m, y_m - self.made_for.y_m
        return (self.pose.x_m + x_m * cos - y_m * sin, self.pose.y_m + x_m * sin + y_m * cos)


class Ball:
    """A ball that moves along way points, whose times count from ``start_s``.

    Between two way points each coordinate is a monotone cubic (F. N. Fritsch and J. Butland, "A method for constructing
    local monotone piecewise cubic interpolants", 1984): the speed never jumps, the ball never goes beyond its way
    points, and it stands still between two that are equal. It stays at the end of its path or begins again.
    """

    def __init__(
        self, *, diameter_m: float, height_m: float, path: Sequence[WayPoint], loop: bool, start_s: float = 0.0
    ) -> None:
        self.diameter_m = diameter_m
        self.height_m = height_m
        self._rounds = deque([_Round(start_s, ORIGIN, ORIGIN)], maxlen=ROUNDS_MAX)
        self._times_s = [point.at for point in path]
        self._period_s = self._times_s[-1] if loop and len(path) > 1 else None
        self._x = _Coordinate(self._times_s, [point.x for point in path], loop)
        self._y = _Coordinate(self._times_s, [point.y for point in path], loop)

    def begin_anew(self, time_s: float, made_for: Pose, pose: Pose) -> None:
        """Begin the path again from a time on, turned and moved as the robot is since the pose it was made for."""
        self._rounds.append(_Round(time_s, made_for, pose))

    def path_s(self, time_s: float) -> float:
        """Return how long it is on its path at a time."""
        return max(0.0, time_s - self._round_at(time_s).start_s)

    def position_m(self, time_s: float) -> tuple[float, float, float]:
        """Return where the ball's centre is: x to the east, y to the north, z up from the floor."""
        return (*self._round_at(time_s).placed(*self._on_path_m(self.path_s(time_s))), self.height_m)

    def _round_at(self, time_s: float) -> _Round:
        return next((each for each in reversed(self._rounds) if each.start_s <= time_s), self._rounds[0])

    def _on_path_m(self, into_s: float) -> tuple[float, float]:
        if self._period_s is not None:
            into_s %= self._period_s
        if into_s >= self._times_s[-1]:
            return (self._x.values[-1], self._y.values[-1])
        index = bisect.bisect_right(self._times_s, into_s) - 1
        return (self._x.between(index, into_s), self._y.between(index, into_s))


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


# The ball takes this long to a new place: a mouse that draws it gives ten places a second or more.
GLIDE_S = 0.1

# It takes this long back to its path.
RETURN_S = 1.0

# The newest moves are remembered, for questions about a moment that has passed.
MOVES_MAX = 256

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class _HandMove:
    """The ball begins to move at `start_s` from a point, to a place (x, y) or, with None, back to its path."""

    start_s: float
    begin: Point
    place: tuple[float, float] | None


class Hand:
    """Where the ball is, by its path and by hand. Like everything in the world, a function of time.

    Args:
        path: Returns where the ball is on its path at a time.
    """

    def __init__(self, path: Callable[[float], Point]) -> None:
        self._path = path
        self._moves: deque[_HandMove] = deque(maxlen=MOVES_MAX)

    @property
    def holds(self) -> bool:
        """Whether it holds the ball away from its path now."""
        return bool(self._moves) and self._moves[-1].place is not None

    def put(self, place: tuple[float, float] | None, now_s: float) -> None:
        """Move the ball to a place from now on, and leave it there; with None, let it go back to its path."""
        if place is not None or self.holds:
            self._moves.append(_HandMove(now_s, self.position_m(now_s), place))

    def position_m(self, time_s: float) -> Point:
        """Return where the ball's centre is: x to the east, y to the north, z up from the floor."""
        on_path = self._path(time_s)
        move = next((each for each in reversed(self._moves) if each.start_s <= time_s), None)
        if move is None:
            return on_path
        end = on_path if move.place is None else (*move.place, on_path[2])
        share = min(1.0, (time_s - move.start_s) / (RETURN_S if move.place is None else GLIDE_S))
        x_m, y_m = (begin + share * (to - begin) for begin, to in zip(move.begin[:2], end[:2], strict=True))
        return (x_m, y_m, on_path[2])
