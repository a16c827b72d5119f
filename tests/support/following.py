"""A robot that follows a ball in the simulated world, through the whole program, as fast as the computer can."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
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


def configuration(base: str, latency_ms: float, follow: str = FOLLOW) -> str:
    """Return a configuration that follows at 1 m, with frames that are some time old."""
    start = SIMULATED_BALL.replace('rate = "30 Hz"', f'rate = "30 Hz"\nlatency = "{latency_ms:g} ms"')
    return f"""{start}
[base]
{BASES[base]}max_speed = "{MAX_SPEED_MPS} m/s"
max_turn_rate = "{MAX_TURN_RADPS} rad/s"
lease = "500 ms"

[safety]
max_frame_age = "350 ms"

[rules.follow]
actuator = "base"
follow = {{ {follow} }}

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
    hidden: Callable[[float], bool] = lambda _: False,
) -> list[Moment]:
    """Follow a ball; return every cycle, with times from the start."""
    path = folder / "following.toml"
    path.write_text(configuration(base, latency_ms))
    loop = Loop(build(load_configuration(path), speed=None))
    world = loop.parts.shared.parts["world"]
    start_s = world.now_s
    world.ball.position_m = lambda at_s: (*ball(max(0.0, at_s - start_s)), 0.1)
    world._hand._path = world.ball.position_m
    moments: list[Moment] = []

    def listen(record: CycleRecord, _frame: object) -> None:
        now_s = record.observation.now_s
        world.faults.target_hidden = hidden(now_s - start_s)
        right_m, _, ahead_m = world.target_in_camera(now_s)
        (twist,) = [each for each in record.applied if each.output == "base"]
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
    loop.run(Limits(seconds=seconds))
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
