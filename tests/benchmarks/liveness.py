"""How soon a camera that only pretends to be live is found, and how often a live one is taken for one that is not.

A simulated robot with a stepped clock follows a ball through rooms in true perspective; each run has a room, a path of
the ball, a noise and a speed of its own, all from its number. Prints the tables of docs/benchmarks/liveness.md.

    PYTHONPATH=tests python tests/benchmarks/liveness.py --runs 100 --hours 2
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from false_raises import interval

from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Image
from support.changed_pictures import KINDS, ChangedCamera

WORLD = """
[camera]
driver = "simulated"
rate = "{rate_hz} Hz"
room = "{room}"
noise = {noise}

[camera.model]
width_px = 320
height_px = 240
fx_px = 300.0

[targets.ball]
detector = "{detector}"

[base]
driver = "{base}"

[rules.follow]
actuator = "base"
follow = {{ distance = "1 m", max_speed = "{speed_mps:.2f} m/s" }}

[world]
seed = {seed}
camera_height = "15 cm"
ticks_per_metre = 3917.7
path = [{path}]
loop = false
comes_back = "1 s"
"""

TEMPLATE = """Milliseconds: median / p95 / worst.

| the sensor froze | stopped | commanded to stand | wheels stand | furthest |
| --- | --- | --- | --- | --- |
{rows}

Seconds, over {replays} runs each: median / worst.

| old pictures in which something changes | ahead, within 2 s | ahead | turning, within 2 s | turning | furthest |
| --- | ---: | ---: | ---: | ---: | ---: |
{changed}

False stops in rooms with texture: {false_stops} in {walks} walks of 10 min; {rate}
Said to be too plain: {wrongly_plain} of {walks} rooms with texture, {rightly_plain} of {plain} plain ones
"""

BALL = 'ball"\ndiameter = "20 cm"\nhsv = "29,86,6:64,255,255'
FIRMWARE = (
    'ros-arduino-bridge"\nport = "emulated-ros-arduino-bridge"\nwheel_diameter = "6.5 cm"\nticks_per_turn = 800\n'
    'track_width = "20 cm'
)
FAULTS = ("frozen_under_clock", "frozen_under_noise")


class Stop(NamedTuple):
    """How a run with a frozen sensor went: when the wheels were commanded to stand and stood, and the way until then.

    Times are infinite for a robot that did not stop.
    """

    commanded_s: float
    stood_s: float
    drove_m: float


def make_loop(**values: object) -> Loop:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "liveness.toml"
        path.write_text(WORLD.format(**values))
        return Loop(build(load_configuration(path), speed=None))


def path_of(points: Sequence[tuple[float, float, float]]) -> str:
    return ", ".join(f'{{ at = "{at:.2f} s", x = "{x:.2f} m", y = "{y:.2f} m" }}' for at, x, y in points)


def freeze(job: tuple[int, str, str, bool]) -> Stop:
    """Run once with a sensor that freezes: while the robot drives, or before it sets off."""
    number, fault, base, is_at_start = job
    rng = np.random.default_rng((number, 11))
    aside_rad, noise = rng.uniform(-0.35, 0.35), rng.uniform(0.5, 5.0)
    towards = (math.cos(aside_rad), math.sin(aside_rad))
    begin_m, end_m = rng.uniform(2.0, 3.5), rng.uniform(8.0, 12.0)
    path = path_of([(0.0, begin_m * towards[0], begin_m * towards[1]), (20.0, end_m * towards[0], end_m * towards[1])])
    loop = make_loop(
        rate_hz=30, room="textured", noise=noise, detector=BALL, base=base, speed_mps=rng.uniform(0.1, 0.4),
        seed=number + 1, path=path,
    )  # fmt: skip
    frozen_s = 0.1 if is_at_start else rng.uniform(1.5, 3.0)
    world = loop.parts.shared.parts["world"]
    cycles: list[tuple[float, float, float]] = []

    def look(record: Any, _frame: object) -> None:
        now_s = record.observation.now_s
        commanded = max((abs(each.linear_mps) + abs(each.angular_radps) for each in record.applied), default=0.0)
        cycles.append((now_s, commanded, sum(world.robot.wheels_mps) / 2))
        if now_s >= frozen_s:
            setattr(world.faults, fault, True)

    loop.listeners.append(look)
    loop.run(Limits(seconds=frozen_s + 3.0))
    begun_s = next(at_s for at_s, commanded, _ in cycles if commanded) if is_at_start else frozen_s
    drove_m = sum(abs(speed_mps) / 30 for at_s, _, speed_mps in cycles if at_s >= begun_s)
    commanded_s, stood_s = (end_s([(each[0], each[column]) for each in cycles], begun_s) for column in (1, 2))
    return Stop(commanded_s, stood_s, drove_m)


def replay(job: tuple[int, str, str, bool]) -> Stop:
    """Run once with a camera that shows old pictures in which something changes, while it drives ahead or turns."""
    number, kind, base, is_turning = job
    rng = np.random.default_rng((number, 13))
    settings = {
        "rate_hz": 30, "room": "textured", "noise": rng.uniform(0.5, 5.0), "detector": BALL, "base": base,
        "speed_mps": rng.uniform(0.1, 0.4), "path": _path(rng, is_turning=is_turning),
    }  # fmt: skip
    fails_s = rng.uniform(3.0, 4.5)
    elsewhere = _pictures(make_loop(seed=number + 501, **settings), 12.0) if "elsewhere" in kind else []
    loop = make_loop(seed=number + 1, **settings)
    _change(loop, kind, fails_s, elsewhere)
    cycles = _cycles(loop, fails_s + 6.0)
    drove_m = sum(abs(speed_mps) / 30 for at_s, _, speed_mps in cycles if at_s >= fails_s)
    commanded_s, stood_s = (end_s([(each[0], each[column]) for each in cycles], fails_s) for column in (1, 2))
    return Stop(commanded_s, stood_s, drove_m)


def _path(rng: np.random.Generator, *, is_turning: bool) -> str:
    """Return the path of a ball that keeps ahead of the robot, or that circles around it."""
    if is_turning:
        radius_m, turn_radps = rng.uniform(1.2, 2.5), rng.choice((-1, 1)) * rng.uniform(0.2, 0.6)
        times_s = np.arange(0.0, 20.0, 0.5)
        return path_of(
            [(at, radius_m * math.cos(turn_radps * at), radius_m * math.sin(turn_radps * at)) for at in times_s]
        )
    aside_rad, begin_m, end_m = rng.uniform(-0.35, 0.35), rng.uniform(2.0, 3.5), rng.uniform(8.0, 12.0)
    x, y = math.cos(aside_rad), math.sin(aside_rad)
    return path_of([(0.0, begin_m * x, begin_m * y), (20.0, end_m * x, end_m * y)])


def _change(loop: Loop, kind: str, fails_s: float, elsewhere: Sequence[Image]) -> ChangedCamera:
    capture: Any = loop.parts.capture
    capture._camera = ChangedCamera(capture._camera, kind, fails_s, elsewhere)
    return capture._camera


def _pictures(loop: Loop, seconds: float) -> list[Image]:
    camera = _change(loop, next(iter(KINDS)), math.inf, [])
    loop.run(Limits(seconds=seconds))
    return camera.taken


def _cycles(loop: Loop, seconds: float) -> list[tuple[float, float, float]]:
    """Run; return the time of each cycle, how fast the base was commanded to move, and how fast its wheels turned."""
    world = loop.parts.shared.parts["world"]
    cycles: list[tuple[float, float, float]] = []

    def look(record: Any, _frame: object) -> None:
        commanded = max((abs(each.linear_mps) + abs(each.angular_radps) for each in record.applied), default=0.0)
        speed_mps = sum(abs(each) for each in world.robot.wheels_mps) / 2
        cycles.append((record.observation.now_s, commanded, speed_mps))

    loop.listeners.append(look)
    loop.run(Limits(seconds=seconds))
    return cycles


def end_s(motion: Sequence[tuple[float, float]], begun_s: float) -> float:
    """Return how long after its beginning a motion ended for good."""
    last_s = max(at_s for at_s, value in motion if abs(value) > 0.001)
    return last_s + 1 / 30 - begun_s if last_s < motion[-1][0] - 0.1 else math.inf


class Walk(NamedTuple):
    """A walk through a live room: how long it drove, its false stops, and whether the room was said to be too plain."""

    drove_s: float
    false_stops: int
    is_said_plain: bool


def walk(job: tuple[int, str, float]) -> Walk:
    """Follow a ball that wanders about in a room, with a sensor that works. A stop ends the walk."""
    number, room, seconds = job
    rng = np.random.default_rng((number, 12))
    points, at_s, place_m = [(0.0, 1.5, 0.0)], 0.0, np.array([1.5, 0.0])
    while at_s < seconds:
        at_s += rng.uniform(1.5, 6.0)
        goal_m = rng.uniform(-4.0, 4.0, 2)
        way_m = goal_m - place_m
        place_m = place_m + way_m * min(1.0, rng.uniform(0.3, 1.5) / float(np.hypot(*way_m)))
        points.append((at_s, *place_m))
    loop = make_loop(
        rate_hz=15, room=room, noise=rng.uniform(0.5, 5.0), detector="ideal", base="simulated", seed=number + 100,
        speed_mps=rng.uniform(0.1, 0.45), path=path_of(points),
    )  # fmt: skip
    drove, stops, plain = 0, 0, False

    def look(record: Any, _frame: object) -> None:
        nonlocal drove, stops, plain
        drove += any(abs(each.linear_mps) + abs(each.angular_radps) > 0.02 for each in record.applied)
        for event in record.decision.events:
            stops += event.kind is EventKind.DISARMED
            plain = plain or event.kind is EventKind.LIVENESS_UNKNOWN
        if stops:
            loop.ending = "it stopped"

    loop.listeners.append(look)
    loop.run(Limits(seconds=seconds))
    return Walk(drove / 15, stops, plain)


def row(words: str, stops: Sequence[Stop]) -> str:
    """Return a line of the table of stops."""
    found = sum(math.isfinite(each.stood_s) for each in stops)
    cells = [words, f"{found} of {len(stops)}"]
    for times_s in (sorted(each.commanded_s for each in stops), sorted(each.stood_s for each in stops)):
        figures_s = (times_s[len(times_s) // 2], times_s[round(0.95 * (len(times_s) - 1))], times_s[-1])
        cells.append(" / ".join(f"{1e3 * each:.0f}" for each in figures_s))
    return f"| {' | '.join(cells)} | {100 * max(each.drove_m for each in stops):.0f} cm |"


def changed_row(kind: str, ahead: Sequence[Stop], turning: Sequence[Stop]) -> str:
    """Return a line of the table of old pictures in which something changes."""
    cells = [kind]
    for stops in (ahead, turning):
        times_s = sorted(each.commanded_s for each in stops)
        cells.append(f"{sum(each <= 2.0 for each in times_s)} of {len(times_s)}")
        cells.append(f"{times_s[len(times_s) // 2]:.2f} / {times_s[-1]:.2f}")
    return f"| {' | '.join(cells)} | {100 * max(each.drove_m for each in (*ahead, *turning)):.0f} cm |"


def measure(runs: int, replays: int, hours: float, jobs: int) -> str:
    """Return the tables."""
    kinds = (
        ("while driving", "simulated", False, runs),
        ("while driving, firmware", FIRMWARE, False, runs),
        ("before it set off", "simulated", True, runs),
    )
    with ProcessPoolExecutor(jobs) as pool:
        walks = [pool.submit(walk, (number, "textured", 600.0)) for number in range(round(6 * hours))]
        plain = [pool.submit(walk, (number, "plain", 3.0)) for number in range(20)]
        stops = [
            (
                f"{words}, {fault.replace('_', ' ')}",
                [pool.submit(freeze, (n, fault, base, early)) for n in range(count)],
            )
            for words, base, early, count in kinds
            for fault in FAULTS
        ]
        changed = [
            (
                kind,
                [[pool.submit(replay, (n, kind, "simulated", way)) for n in range(replays)] for way in (False, True)],
            )
            for kind in KINDS
        ]
        of_kinds = [
            changed_row(kind, *([each.result() for each in of_way] for of_way in ways)) for kind, ways in changed
        ]
        rows = [row(words, [each.result() for each in results]) for words, results in stops]
        live, bare = [each.result() for each in walks], [each.result() for each in plain]
    false_stops, drove_s = sum(each.false_stops for each in live), sum(each.drove_s for each in live)
    low, high = interval(false_stops, drove_s / 3600)
    return TEMPLATE.format(
        rows="\n".join(rows),
        replays=replays,
        changed="\n".join(of_kinds),
        false_stops=false_stops,
        rate=f"it drove {drove_s / 3600:.1f} h; an hour of driving, with a confidence of 95 %: {low:.2f} to {high:.1f}",
        wrongly_plain=sum(each.is_said_plain for each in live),
        walks=len(live),
        rightly_plain=sum(each.is_said_plain for each in bare),
        plain=len(bare),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--replays", type=int, default=10, help="of each kind of old pictures, ahead and turning")
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    print(measure(given.runs, given.replays, given.hours, given.jobs))


if __name__ == "__main__":
    main()
