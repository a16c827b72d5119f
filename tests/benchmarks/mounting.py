"""How surely a camera that was moved is found, and how often one that was not is said to be: rendered days.

    PYTHONPATH=tests python tests/benchmarks/mounting.py SEED…

Each seed is a room of its own and a day of 1,440 checks, one a minute, in which the camera stays where it is: every
finding is a false one. Every hour the camera is moved in thought, with all that was learnt until then: by 0.2° about an
axis of random direction, by a zoom of 1 % either way, and by a refocus that makes of a point a disc of 2 px (the half
step of this benchmark), for two checks each; in the dark for two checks, and two more when there is light.

Each seed is also a house of 12 rooms, and a day of a robot that looks into one of them a minute, from another place
each time. Every other hour of light its camera is refocused in thought, to discs of 2 and of 4 px, for as many checks
as are judged together.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator
from copy import deepcopy

import cv2
import numpy as np

from stadimeter.perception.background import BackgroundView, keep_still, look_at
from stadimeter.perception.mounting import ROBOT_CHECKS, MountingJudge, MountingLimits
from support.watched_room import LENS, LIGHT_AGAIN_AT, Pose, WatchedRoom, is_dark

MINUTES = 24 * 60
SAVED_AT = 10 * 60


def look(room: WatchedRoom, minute: float, pose: Pose | None = None) -> BackgroundView:
    """Return the view of a room at a minute of any day."""
    return look_at(room.pictures(minute % MINUTES, pose), LENS)


def saved_view(room: WatchedRoom) -> BackgroundView:
    """Return the view of a room as `stadimeter mounting save` would save it."""
    return keep_still([look(room, SAVED_AT + 0.01 * each) for each in range(3)])


def disturbances(rng: np.random.Generator) -> Iterator[tuple[str, str, Pose]]:
    """Yield what is done to the camera: a name, the finding that it should be, and its pose."""
    axis = rng.standard_normal(3)
    pan, tilt, roll = 0.2 * axis / np.linalg.norm(axis)
    yield "turned by 0.2°", "moved", Pose(pan_deg=pan, tilt_deg=tilt, roll_deg=roll)
    yield "zoomed by 1 %", "zoomed", Pose(zoom=float(rng.choice([-0.01, 0.01])))
    yield "refocused by half a step", "refocused", Pose(blur_px=2.0)


def disturb(room: WatchedRoom, views: list[BackgroundView], now: float, rng: np.random.Generator) -> Counter[str]:
    """Return what is found of a camera that is moved at a minute."""
    counts: Counter[str] = Counter()
    for name, kind, pose in disturbances(rng):
        judge = MountingJudge([*views])
        minutes, where = [now + 0.3, now + 1.3], ""
        if is_dark(now):
            minutes, where = [*minutes, LIGHT_AGAIN_AT, LIGHT_AGAIN_AT + 1.0], ", in the dark"
        judged = [judge.judge(look(room, each, pose)) for each in minutes]
        counts["judged in the dark"] += sum(not each.not_judged for each in judged[:-2])
        is_found = kind in judged[-1].settled
        counts[f"{name}{where}: {'found' if is_found else 'missed'}"] += 1
        if not is_found:
            best = judged[-1].best
            print(f"minute {now}, {name}: {judged[-1].not_judged or (best and best.in_words())}", flush=True)
    return counts


def live_a_day(seed: int) -> Counter[str]:
    """Return what was found of what in a room."""
    room, rng = WatchedRoom(seed), np.random.default_rng((seed, 99))
    judge = MountingJudge([saved_view(room)])
    counts: Counter[str] = Counter()
    costs_s: list[float] = []
    was: dict[str, str] = {}
    for minute in range(MINUTES):
        now = (SAVED_AT + minute) % MINUTES
        pictures = room.pictures(now)
        began_s = time.thread_time()
        found = judge.judge(look_at(pictures, LENS))
        costs_s.append(time.thread_time() - began_s)
        counts["checks"] += 1
        counts["not judged, in light"] += bool(found.not_judged) and not is_dark(now)
        counts["not judged, in the dark"] += bool(found.not_judged) and is_dark(now)
        counts["learnt"] += found.has_learnt
        counts["single findings"] += bool(found.found)
        if found.settled and not was:
            counts["false findings"] += 1
            print(f"false at minute {now}: {found.settled}", flush=True)
        was = found.settled
        if minute % 60 == 30:
            counts += disturb(room, judge.views, now, rng)
    print(f"a check takes {1e3 * float(np.median(costs_s)):.0f} ms")
    return counts


def drive_a_day(seed: int) -> Counter[str]:
    """Return what was found of what by a robot."""
    rooms, rng = [WatchedRoom(seed * 100 + each) for each in range(12)], np.random.default_rng((seed, 98))

    def look_anywhere(minute: float, blur_px: float = 0.0) -> BackgroundView:
        pan, tilt, zoom = rng.uniform((-6, -3, -0.1), (6, 3, 0.3))
        pose = Pose(pan_deg=pan, tilt_deg=tilt, zoom=zoom, blur_px=blur_px)
        return look(rooms[rng.integers(len(rooms))], minute, pose)

    judge = MountingJudge([saved_view(rooms[0])], MountingLimits(judges_place=False))
    counts: Counter[str] = Counter()
    was: dict[str, str] = {}
    for minute in range(MINUTES):
        now = (SAVED_AT + minute) % MINUTES
        found = judge.judge(look_anywhere(now))
        counts["on a robot, checks"] += 1
        counts["on a robot, not judged"] += bool(found.not_judged)
        counts["on a robot, false findings"] += bool(found.settled) and not was
        was = found.settled
        if minute % 120 == 0 and len(judge.views) > 1 and not is_dark(now):
            for disc_px in (2.0, 4.0):
                thought = deepcopy(judge)
                later = [bool(thought.judge(look_anywhere(now, disc_px)).settled) for _ in range(ROBOT_CHECKS)]
                counts[f"on a robot, a disc of {disc_px:g} px: {'found' if any(later) else 'missed'}"] += 1
    return counts


def main() -> None:
    """Print the figures of some seeds."""
    cv2.setNumThreads(1)
    total: Counter[str] = Counter()
    for seed in map(int, sys.argv[1:]):
        for day in (live_a_day, drive_a_day):
            counts = day(seed)
            total += counts
            print(seed, dict(counts), flush=True)
    print(dict(total))


if __name__ == "__main__":
    main()
