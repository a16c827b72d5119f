"""How surely a camera that was moved is found, and how often one that was not is said to be: rendered days.

    PYTHONPATH=tests python tests/benchmarks/mounting.py SEED…

Each seed is a room of its own and a day of 1,440 checks, one a minute, in which the camera stays where it is: every
finding is a false one. Every hour the camera is moved in thought, with all that was learnt until then: by 0.2° about an
axis of random direction, by a zoom of 1 % either way, and by a refocus that makes of a point a disc of 2 px (the half
step of this benchmark), for two checks each.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator

import cv2
import numpy as np

from stadimeter.perception.background import BackgroundView, keep_still, look_at
from stadimeter.perception.mounting import CHECKS_IN_A_ROW, MountingJudge
from support.watched_room import LENS, Pose, WatchedRoom

MINUTES = 24 * 60
SAVED_AT = 10 * 60


def saved_view(room: WatchedRoom, minute: float) -> BackgroundView:
    """Return the view of a room as `stadimeter mounting save` would save it."""
    return keep_still([look_at(room.pair(minute + 0.01 * each), LENS) for each in range(3)])


def disturbances(rng: np.random.Generator) -> Iterator[tuple[str, str, Pose]]:
    """Yield what is done to the camera: a name, the finding that it should be, and its pose."""
    axis = rng.standard_normal(3)
    pan, tilt, roll = 0.2 * axis / np.linalg.norm(axis)
    yield "turned by 0.2°", "moved", Pose(pan_deg=pan, tilt_deg=tilt, roll_deg=roll)
    yield "zoomed by 1 %", "zoomed", Pose(zoom=float(rng.choice([-0.01, 0.01])))
    yield "refocused by half a step", "refocused", Pose(blur_px=2.0)


def live_a_day(seed: int) -> tuple[Counter[str], list[str], list[float]]:
    """Return what was found of what, the false findings, and the seconds of each check."""
    room, rng = WatchedRoom(seed), np.random.default_rng((seed, 99))
    judge = MountingJudge([saved_view(room, SAVED_AT)])
    counts: Counter[str] = Counter()
    false: list[str] = []
    costs_s: list[float] = []
    was: dict[str, str] = {}
    for minute in range(MINUTES):
        now = (SAVED_AT + minute) % MINUTES
        pair = room.pair(now)
        began_s = time.thread_time()
        found = judge.judge(look_at(pair, LENS))
        costs_s.append(time.thread_time() - began_s)
        counts["checks"] += 1
        counts["not judged"] += bool(found.not_judged)
        counts["learnt"] += found.has_learnt
        counts["single findings"] += bool(found.found)
        if found.settled and not was:
            false.append(f"minute {now}: {found.settled}")
        was = found.settled
        if minute % 60 == 59:
            print(seed, dict(counts), f"false: {false}", f"{1e3 * float(np.median(costs_s)):.0f} ms", flush=True)
        if minute % 60 == 30:
            for name, kind, pose in disturbances(rng):
                thought = MountingJudge([*judge.views])
                for check in range(CHECKS_IN_A_ROW[kind]):
                    found = thought.judge(look_at(room.pair((now + 0.3 + check) % MINUTES, pose), LENS))
                counts[f"{name}: {'found' if kind in found.settled else 'missed'}"] += 1
                if kind not in found.settled:
                    what = found.not_judged or (found.best.in_words() if found.best else found.found)
                    print(f"minute {now}, {name}: {what}", flush=True)
    return counts, false, costs_s


def main() -> None:
    """Print the figures of some seeds."""
    cv2.setNumThreads(1)
    total: Counter[str] = Counter()
    for seed in map(int, sys.argv[1:]):
        counts, false, costs_s = live_a_day(seed)
        total += counts
        total["false findings"] += len(false)
        print(seed, dict(counts), f"false: {false}", f"median {1e3 * float(np.median(costs_s)):.0f} ms", flush=True)
    print(dict(total))


if __name__ == "__main__":
    main()
