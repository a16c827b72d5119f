"""A robot that follows a ball in the simulated world, through the whole program, as fast as the computer can.

Nothing here can be late, however busy the computer is: one thread steps the clock, and the emulated board is served
within these steps, each 10 ms of the run. A pseudo-terminal has what was written ready for the next read, so the board
answers one service later at most. What judges by real time is the stall watch alone, which stops the wheels when the
clock has stood still for half a second; it is off here. So each run is the same each time, and a fault is a defect.
"""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

from msgspec import Struct

from stadimeter.app import guard
from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.command import TwistCommand
from stadimeter.simulation.motion import Pose
from support.simulated_run import SIMULATED_BALL

# A base with wheels that lag by 0.1 s, behind real serial bytes, and one that obeys at once.
BASES = {
    "emulated": """driver = "ros-arduino-bridge"
port = "emulated-ros-arduino-bridge"
wheel_diameter = "6.5 cm"
ticks_per_turn = 800
track_width = "20 cm"
max_wheel_speed = "0.9 m/s"
""",
    "ideal": 'driver = "simulated"\nmax_wheel_speed = "0.9 m/s"\n',
}

FOLLOW = 'distance = "1 m", max_speed = "0.6 m/s", max_reverse_speed = "0.6 m/s", max_turn_rate = "2 rad/s"'
MAX_SPEED_MPS, MAX_TURN_RADPS = 0.6, 2.0

# What is applied is rounded to whole encoder ticks per frame of the sketch: this many m/s of a wheel.
TICK_MPS = 0.004

# In an eventful walk the ball leaves the view at this speed, and rests for this long.
LEAVES_MPS, LEFT_S = 2.0, 10.0

Path2 = Callable[[float], tuple[float, float]]
"""Where a ball is on the floor, by the time in seconds since the start."""


class Moment(Struct, frozen=True):
    """One cycle: the truth, what the base was told, and what the program knew."""

    at_s: float
    gap_m: float
    bearing_rad: float
    linear_mps: float
    angular_radps: float
    is_tracked: bool
    events: tuple[str, ...]


def configuration(base: str, latency_ms: float, rule: str, most: str) -> str:
    """Return a configuration that follows at 1 m, with frames that are some time old."""
    start = SIMULATED_BALL.replace('rate = "30 Hz"', f'rate = "30 Hz"\nlatency = "{latency_ms:g} ms"')
    return f"""{start}
[base]
{BASES[base]}max_speed = "{most}"
max_turn_rate = "{MAX_TURN_RADPS} rad/s"
lease = "500 ms"

[safety]
max_frame_age = "350 ms"

[rules.follow]
actuator = "base"
follow = {{ {rule} }}

[world]
camera_height = "12 cm"
ticks_per_metre = 3917.7
"""


def follow(
    folder: Path,
    seconds: float,
    ball: Path2,
    *,
    base: str = "emulated",
    latency_ms: float = 30.0,
    rule: str = FOLLOW,
    most: str = f"{MAX_SPEED_MPS} m/s",
    hidden: Callable[[float], bool] = lambda _: False,
) -> list[Moment]:
    """Follow a ball; return every cycle, with times from the start."""
    path = folder / "following.toml"
    path.write_text(configuration(base, latency_ms, rule, most))
    loop = Loop(build(load_configuration(path), speed=None))
    world = loop.parts.shared.parts["world"]
    start_s = world.now_s
    world.ball.position_m = lambda at_s: (*ball(max(0.0, at_s - start_s)), 0.1)
    world._hand._path = world.ball.position_m
    if isinstance(ball, EventfulWalk):
        ball.robot_at = lambda at_s: world.robot.pose_at(start_s + at_s)
    moments: list[Moment] = []

    def listen(record: CycleRecord, _frame: object) -> None:
        now_s = record.observation.now_s
        world.faults.target_hidden = hidden(now_s - start_s)
        right_m, _, ahead_m = world.target_in_camera(now_s)
        stands = TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0)  # out of order
        twist = next((each for each in record.applied if each.output == "base"), stands)
        moments.append(
            Moment(
                now_s - start_s,
                world.distance_m(now_s),
                math.atan2(right_m, ahead_m),
                twist.linear_mps,
                twist.angular_radps,
                record.decision.tracks[0].is_valid,
                tuple(event.kind.value for event in record.decision.events),
            )
        )

    loop.listeners.append(listen)
    with patch.object(guard, "STALLED_AFTER_S", math.inf):
        loop.run(Limits(seconds=seconds))
    faults = [each for each in moments if "fault" in each.events]
    assert not faults, f"the base failed, though nothing was wrong with it: {faults}"
    return moments


def stands(x_m: float) -> Path2:
    """Return a ball that stands ahead."""
    return lambda _: (x_m, 0.0)


def walks_away(at_s: float) -> tuple[float, float]:
    """Return a ball that rests for 2 s and then goes away at 0.3 m/s."""
    return 1.0 + 0.3 * max(0.0, at_s - 2.0), 0.0


def sways(at_s: float) -> tuple[float, float]:
    """Return a ball that goes to and fro at up to 0.5 m/s, once in 10 s, and sways sideways by ± 0.3 m."""
    turns = 2 * math.pi * at_s
    return 1.8 - 0.8 * math.cos(0.1 * turns), 0.3 * math.sin(0.17 * turns)


def swaying_path(seed: int) -> Path2:
    """Return a ball that goes to and fro at up to 0.5 m/s, and sways sideways at up to 0.33 m/s.

    Periods, amplitudes and phases are random; it sets off within 3 s. No ball accelerates by more than 0.5 m/s² or so,
    which is what the base can.
    """
    rng = random.Random(seed)  # noqa: S311 - the same path each time
    period_s, phase = rng.uniform(8, 14), rng.uniform(0, 2 * math.pi)
    aside_m, aside_s, aside = rng.uniform(0.2, 0.4), rng.uniform(4.5, 10), rng.uniform(0, 2 * math.pi)
    rate_radps, aside_radps = 2 * math.pi / period_s, min(2 * math.pi / aside_s, 0.33 / aside_m)
    ahead_m = 0.5 / rate_radps

    def at(at_s: float) -> tuple[float, float]:
        into_s = at_s * at_s / 6 if at_s < 3 else at_s - 1.5
        return (
            1.0 + ahead_m * (math.cos(phase) - math.cos(phase + rate_radps * into_s)),
            aside_m * (math.sin(aside + aside_radps * into_s) - math.sin(aside)),
        )

    return at


def random_walk(seed: int, seconds: float) -> Path2:
    """Return a ball that walks about a room of 6 m: from place to place at 0.15 to 0.4 m/s, with rests."""
    rng = random.Random(seed)  # noqa: S311 - the same walk each time
    legs, now_s, place = [], 2.0, (1.2, 0.0)
    while now_s < seconds:
        there = rng.uniform(-3, 3), rng.uniform(-3, 3)
        lasts_s = max(1.0, math.dist(place, there) / rng.uniform(0.15, 0.3))
        legs.append((now_s, lasts_s, place, there))
        now_s, place = now_s + lasts_s + rng.uniform(0, 2), there

    def at(at_s: float) -> tuple[float, float]:
        begin_s, lasts_s, here, there = next(
            (leg for leg in reversed(legs) if leg[0] <= at_s), (0, 1, (1.2, 0.0), (1.2, 0.0))
        )
        share = min(1.0, (at_s - begin_s) / lasts_s)
        share = share * share * (3 - 2 * share)  # at most 1.5 times its mean speed
        return tuple(a + share * (b - a) for a, b in zip(here, there, strict=True))  # type: ignore[return-value]

    return at


class EventfulWalk:
    """A random walk of a ball that is hidden for 1 s, and leaves the view, in turn, every 20 to 35 s.

    It leaves the view in an arc around the robot, by 60° to 170° to either side, at 2 m/s; there it rests for 10 s,
    before it walks on.

    Attributes:
        robot_at: Where the robot is by the time in seconds since the start; `follow` sets it.
        hidden_s: When it is hidden.
        leaves_s: When it leaves the view.
    """

    def __init__(self, seed: int, seconds: float) -> None:
        rng = random.Random(1000 + seed)  # noqa: S311 - the same walk each time
        self._walk = random_walk(seed, seconds)
        self._turns_rad: list[float] = []
        self._arcs: list[tuple[complex, complex, complex]] = []
        self.robot_at: Callable[[float], Pose] = lambda _: Pose(x_m=0.0, y_m=0.0, heading_rad=0.0)
        self.hidden_s: list[float] = []
        self.leaves_s: list[float] = []
        at_s = rng.uniform(8, 15)
        while at_s < seconds - 12:
            if len(self.hidden_s) <= len(self.leaves_s):
                self.hidden_s.append(at_s)
            else:
                self.leaves_s.append(at_s)
                self._turns_rad.append(math.radians(rng.uniform(60, 170)) * rng.choice((-1, 1)))
            at_s += rng.uniform(20, 35)

    def is_hidden(self, at_s: float) -> bool:
        """Return whether something stands before the ball."""
        return any(since_s <= at_s < since_s + 1.0 for since_s in self.hidden_s)

    def __call__(self, at_s: float) -> tuple[float, float]:
        """Return where the ball is."""
        while len(self._arcs) < len(self.leaves_s) and self.leaves_s[len(self._arcs)] <= at_s:
            self._begin_arc()
        begun = sum(since_s <= at_s for since_s in self.leaves_s)
        place = complex(*self._walk(self._walked_s(at_s)))
        if begun:
            robot, ball, walk = self._arcs[begun - 1]
            turn_rad, arm = self._turns_rad[begun - 1], ball - robot
            share = min(1.0, (at_s - self.leaves_s[begun - 1]) * LEAVES_MPS / (abs(arm) * abs(turn_rad)))
            place += robot + arm * cmath.rect(1, share * turn_rad) - walk
        return place.real, place.imag

    def _walked_s(self, at_s: float) -> float:
        """Return for how long it has walked by a time."""
        return at_s - sum(min(LEFT_S, max(0.0, at_s - since_s)) for since_s in self.leaves_s)

    def _begin_arc(self) -> None:
        since_s = self.leaves_s[len(self._arcs)]
        robot, ball = self.robot_at(since_s), complex(*self(math.nextafter(since_s, 0.0)))
        self._arcs.append((complex(robot.x_m, robot.y_m), ball, complex(*self._walk(self._walked_s(since_s)))))


def rms(values: list[float]) -> float:
    """Return the root of the mean square."""
    return math.sqrt(sum(value * value for value in values) / len(values))


def out_of_sight_s(moments: list[Moment]) -> list[float]:
    """Return for how long each time the target was not tracked, after it was first."""
    spans, since_s, was_seen = [], None, False
    for moment in moments:
        if moment.is_tracked:
            if since_s is not None:
                spans.append(moment.at_s - since_s)
            since_s, was_seen = None, True
        elif was_seen and since_s is None:
            since_s = moment.at_s
    return spans if since_s is None else [*spans, math.inf]


def is_within_limits(moments: list[Moment]) -> bool:
    """Return whether no command was over a limit, apart from rounding."""
    most_radps = MAX_TURN_RADPS + TICK_MPS / 0.1
    return all(
        abs(each.linear_mps) <= MAX_SPEED_MPS + TICK_MPS and abs(each.angular_radps) <= most_radps for each in moments
    )
