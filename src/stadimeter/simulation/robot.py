"""A robot on two driven wheels."""

from __future__ import annotations

import bisect
import math
import threading
from collections import deque
from dataclasses import dataclass

from stadimeter.core.clock import Clock
from stadimeter.errors import CommandRangeError, DriverError

# Changes of speed that a robot remembers: 20 s of one every 20 ms.
MEMORY = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Position on the floor, x to the east and y to the north, and heading, as in ROS REP 103."""

    x_m: float
    y_m: float
    heading_rad: float  # counter-clockwise from east, not wrapped: a full turn to the left adds 2π


@dataclass(frozen=True, slots=True, kw_only=True)
class _Leg:
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
