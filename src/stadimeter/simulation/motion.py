"""Motion of things in the simulated world: a robot on two driven wheels, and a ball on a path or in a hand."""

from __future__ import annotations

import bisect
import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from itertools import pairwise

from msgspec import Struct

from stadimeter.config.plugins import OptionsTable
from stadimeter.config.units import Coordinate, Duration, LengthOrZero
from stadimeter.core.clock import Clock
from stadimeter.errors import CommandRangeError, DriverError

# Changes of speed that a robot remembers: 20 s of one every 20 ms.
MEMORY = 1000


class Pose(Struct, frozen=True, kw_only=True):
    """Position on the floor, x to the east and y to the north, and heading, as in ROS REP 103."""

    x_m: float
    y_m: float
    heading_rad: float  # counter-clockwise from east, not wrapped: a full turn to the left adds 2π


class _Leg(Struct, frozen=True, kw_only=True):
    """A stretch of time with the same wheel speeds: an arc of a circle, then standing still."""

    begin_s: float
    moving_s: float  # for how long the wheels turn, at most
    wheels_mps: tuple[float, float]  # speeds of the left and the right wheel
    pose: Pose
    travel_m: tuple[float, float]  # what each wheel had covered when it began

    def driven_s(self, time_s: float) -> float:
        """Return for how long the wheels have turned at a time."""
        return max(0.0, min(time_s - self.begin_s, self.moving_s))


class DifferentialRobot:
    """A robot on two driven wheels that hold the commanded speed, without slip.

    It takes no steps: with steady wheels a robot runs along an arc of a circle, so the pose at any time follows exactly
    from the last change of speed. May be used from several threads.
    """

    def __init__(self, *, track_width_m: float, ticks_per_metre: float, start: Pose, clock: Clock) -> None:
        self.track_width_m = track_width_m
        self.ticks_per_metre = ticks_per_metre
        self.start = start
        self._clock = clock
        self._lock = threading.RLock()  # a signal handler may stop the robot while its thread is in here
        standing = _Leg(begin_s=-math.inf, moving_s=0.0, wheels_mps=(0.0, 0.0), pose=start, travel_m=(0.0, 0.0))
        self._legs = deque([standing], maxlen=MEMORY)

    def drive_wheels(self, left_mps: float, right_mps: float, until_s: float = math.inf) -> None:
        """Turn the wheels from now on, forwards positive, until they stop by themselves.

        Raises:
            CommandRangeError: A speed is not finite, or the time is not a number.
        """
        if not (math.isfinite(left_mps) and math.isfinite(right_mps)) or math.isnan(until_s):
            raise CommandRangeError(f"wheels cannot turn at {left_mps} and {right_mps} m/s until {until_s} s")
        now_s = self._clock.now_s()
        with self._lock:
            last = self._legs[-1]
            if (left_mps, right_mps) == last.wheels_mps and until_s == last.begin_s + last.moving_s:
                return
            self._legs.append(
                _Leg(
                    begin_s=now_s,
                    moving_s=max(0.0, until_s - now_s),
                    wheels_mps=(left_mps, right_mps),
                    pose=self._pose_on(last, now_s),
                    travel_m=_travel_on(last, now_s),
                )
            )

    @property
    def pose(self) -> Pose:
        """The present pose of the robot."""
        return self.pose_at(self._clock.now_s())

    @property
    def wheels_mps(self) -> tuple[float, float]:
        """The present speeds of the left and the right wheel."""
        leg, now_s = self._legs[-1], self._clock.now_s()
        return leg.wheels_mps if now_s - leg.begin_s < leg.moving_s else (0.0, 0.0)

    @property
    def ticks(self) -> tuple[int, int]:
        """The encoder counts of the left and the right wheel since the start."""
        left_m, right_m = _travel_on(self._legs[-1], self._clock.now_s())
        return (math.floor(left_m * self.ticks_per_metre), math.floor(right_m * self.ticks_per_metre))

    def pose_at(self, time_s: float) -> Pose:
        """Return where the robot was at a time, or will be if the wheels go on like this.

        Raises:
            DriverError: That is longer ago than the robot remembers.
        """
        with self._lock:
            leg = self._legs[-1]
            if time_s < leg.begin_s:
                leg = self._leg_at(time_s)
        return self._pose_on(leg, time_s)

    def _leg_at(self, time_s: float) -> _Leg:
        index = bisect.bisect_right(self._legs, time_s, key=lambda leg: leg.begin_s) - 1
        if index < 0:
            raise DriverError(
                f"the simulated robot remembers its way back to {self._legs[0].begin_s:.3f} s, not to {time_s:.3f} s"
            )
        return self._legs[index]

    def _pose_on(self, leg: _Leg, time_s: float) -> Pose:
        """Follow the arc: its chord points along the mean heading and has the arc's length times sin(a/2)/(a/2)."""
        driven_s = leg.driven_s(time_s)
        left_mps, right_mps = leg.wheels_mps
        if not driven_s or left_mps == right_mps == 0.0:
            return leg.pose
        half_turn = (right_mps - left_mps) / self.track_width_m * driven_s / 2
        chord_m = (left_mps + right_mps) / 2 * driven_s * (math.sin(half_turn) / half_turn if half_turn else 1.0)
        along_rad = leg.pose.heading_rad + half_turn
        return Pose(
            x_m=leg.pose.x_m + chord_m * math.cos(along_rad),
            y_m=leg.pose.y_m + chord_m * math.sin(along_rad),
            heading_rad=along_rad + half_turn,
        )


def _travel_on(leg: _Leg, time_s: float) -> tuple[float, float]:
    driven_s = leg.driven_s(time_s)
    return (leg.travel_m[0] + leg.wheels_mps[0] * driven_s, leg.travel_m[1] + leg.wheels_mps[1] * driven_s)


ORIGIN = Pose(x_m=0.0, y_m=0.0, heading_rad=0.0)

Point = tuple[float, float, float]

# The newest beginnings of the path are remembered, for questions about a moment that has passed.
ROUNDS_MAX = 16


class WayPoint(OptionsTable):
    """The position of the ball at some time."""

    at: Duration
    """When, in seconds from the start of the run."""
    x: Coordinate
    """Metres to the east."""
    y: Coordinate
    """Metres to the north."""
    z: LengthOrZero | None = None
    """Height of the ball's centre above the floor; None for the usual one of the ball."""


class _Round(Struct, frozen=True):
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
        self._z = _Coordinate(self._times_s, [height_m if point.z is None else point.z for point in path], loop)

    def begin_anew(self, time_s: float, made_for: Pose, pose: Pose) -> None:
        """Begin the path again from a time on, turned and moved as the robot is since the pose it was made for."""
        self._rounds.append(_Round(time_s, made_for, pose))

    def path_s(self, time_s: float) -> float:
        """Return the time it is on its path at a time."""
        return max(0.0, time_s - self._round_at(time_s).start_s)

    def position_m(self, time_s: float) -> tuple[float, float, float]:
        """Return where the ball's centre is: x to the east, y to the north, z up from the floor."""
        x_m, y_m, z_m = self._on_path_m(self.path_s(time_s))
        return (*self._round_at(time_s).placed(x_m, y_m), z_m)

    def _round_at(self, time_s: float) -> _Round:
        return next((each for each in reversed(self._rounds) if each.start_s <= time_s), self._rounds[0])

    def _on_path_m(self, into_s: float) -> Point:
        if self._period_s is not None:
            into_s %= self._period_s
        if into_s >= self._times_s[-1]:
            return (self._x.values[-1], self._y.values[-1], self._z.values[-1])
        index = bisect.bisect_right(self._times_s, into_s) - 1
        return (self._x.between(index, into_s), self._y.between(index, into_s), self._z.between(index, into_s))


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


class _HandMove(Struct, frozen=True):
    """The ball begins to move at `start_s` from a point, to a place (x, y) or, with None, back to its path."""

    start_s: float
    begin: Point
    place: tuple[float, float] | None


class Hand:
    """The place of the ball, by its path and by hand. Like everything in the world, a function of time.

    Args:
        path: Returns where the ball is on its path at a time.
    """

    def __init__(self, path: Callable[[float], Point]) -> None:
        self._path = path
        self._moves: deque[_HandMove] = deque(maxlen=MOVES_MAX)

    @property
    def holds(self) -> bool:
        """True while it holds the ball away from its path."""
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
