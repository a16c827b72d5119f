"""How surely dirt on a part of the lens is found, and how often a clean one is said to be dirty: rendered days.

    PYTHONPATH=tests python tests/benchmarks/lens_dirt.py SEED…

Each seed is a room of its own. One day is learnt; the next has other people and other clouds, and the same sun. Each
half hour of its light is judged without dirt, and every other one with a speck and with a drop as well, a tenth of the
picture's width across, at a place of its own. For those every third picture is rendered, and judged three times.
"""

from __future__ import annotations

import sys
from collections import Counter
from copy import deepcopy

import cv2
import numpy as np

from benchmarks.mounting import MINUTES, SAVED_AT
from stadimeter.perception.background import Plane
from stadimeter.perception.lens_dirt import CHECKS, HALF_HOURS, PART_PX, DirtJudge, look_at_parts
from support.watched_room import HEIGHT_PX, LENS, WIDTH_PX, Pose, WatchedRoom, is_dark

DISC_PX = 64.0

# A part with less energy of its fine details shows none that a drop could take.
DETAIL = 0.0


class DirtyRoom(WatchedRoom):
    """A room seen through a lens that is dirty at times."""

    dirt: tuple[str, float, float] | None = None

    def _seen(self, scene: np.ndarray, pose: Pose) -> np.ndarray:
        seen = super()._seen(scene, pose)
        if self.dirt is None:
            return seen
        kind, x, y = self.dirt
        rows, columns = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(np.float32)
        inside = np.clip((DISC_PX / 2 - np.hypot(columns - x, rows - y)) / 6 + 0.5, 0, 1)
        if kind == "drop":
            return seen * (1 - inside) + cv2.GaussianBlur(seen, (0, 0), 5) * inside
        return seen * (1 - 0.9 * cv2.GaussianBlur(inside, (0, 0), 4))


def look(room: DirtyRoom, minute: int) -> Plane:
    """Return the parts of a room at a minute of any day."""
    now = minute % MINUTES
    if is_dark(now):
        return np.full((2, HEIGHT_PX // PART_PX, WIDTH_PX // PART_PX), np.inf, np.float32)
    return look_at_parts(room.pictures(now), LENS)


def soil(room: DirtyRoom, judge: DirtJudge, minute: int, rng: np.random.Generator) -> Counter[str]:
    """Return what is found of a speck and of a drop in half an hour."""
    counts: Counter[str] = Counter()
    rows, columns = PART_PX * (np.mgrid[0 : HEIGHT_PX // PART_PX, 0 : WIDTH_PX // PART_PX] + 0.5)
    least = np.min(judge._least, axis=0)
    for kind in ("drop", "speck"):
        x, y = rng.uniform((60, 60), (580, 420))
        room.dirt, thought = (kind, x, y), deepcopy(judge)
        words = ""
        for each in range(0, CHECKS, 3):
            parts = look(room, minute + each)
            words = [thought.judge(parts) for _ in range(3)][-1]
        room.dirt = None
        shows = least[0][np.hypot(columns - x, rows - y) < 24] > DETAIL
        counts[
            f"{kind} before {'detail' if shows.sum() >= 3 else 'a plain part'}: {'found' if words else 'missed'}"
        ] += 1
    return counts


def judge_a_day(seed: int) -> Counter[str]:
    """Return what was found of what in a room."""
    room, places = DirtyRoom(seed), np.random.default_rng((seed, 98))
    judge, counts = DirtJudge(), Counter[str]()
    for minute in range(HALF_HOURS * CHECKS):
        judge.judge(look(room, SAVED_AT + minute))
    other = np.random.default_rng((seed, 97))
    room.seed += 1000  # from here on it decides on the clouds only
    room.people = [(*other.uniform(0, 1, 3), int(other.integers(1 << 30))) for _ in range(3)]
    for half_hour in range(HALF_HOURS):
        minute, before = SAVED_AT + CHECKS * half_hour, deepcopy(judge)
        is_light = not is_dark(minute % MINUTES)
        if is_light and half_hour % 2 == 0:
            counts += soil(room, judge, minute, places)
        words = [judge.judge(look(room, minute + each)) for each in range(CHECKS)][-1]
        counts["half hours of light"] += is_light
        counts["false findings"] += is_light and bool(words)
        if words:
            print(f"minute {minute % MINUTES}: {words}", flush=True)
            judge = before
    return counts


def main() -> None:
    """Print the figures of some seeds."""
    cv2.setNumThreads(1)
    for seed in map(int, sys.argv[1:]):
        print(seed, dict(judge_a_day(seed)), flush=True)


if __name__ == "__main__":
    main()
