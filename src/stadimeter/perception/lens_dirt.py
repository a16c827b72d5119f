"""Finds a part of the picture that shows less than it did for a day and a night: something on the lens, or before it.

A speck takes light from some parts, a drop takes their fine details. Light takes both too, but not for longer than it
did at some other hour. So each part is compared with the least that it showed in any other half hour of the last day,
relative to the rest of the picture. It is learnt anew after each start, and in memory only.

All figures here were chosen on two rendered days (seeds 501 and 502).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.perception.background import Plane, average_in_two, cover

PART_PX = 16

# A part that falls by more, in natural logarithms: of the energy of its fine details, and of its mean grey level.
FALLS = (1.0, 0.7)

# So many parts across and down are neighbours. A lamp that is switched on brightens them alike.
NEIGHBOURS = (11, 11)

# Parts beside each other that fall together. Where more than this share of all do, the light has changed.
PARTS_MIN, SHARE_MAX = 3, 0.25

# They count that fell in this share of the checks of half an hour: people stand for less. A day has so many of these.
CHECKS, LASTING, HALF_HOURS = 30, 0.8, 48

# An energy below this is mostly noise, and a part with more white pixels than this share shows nothing.
ENERGY_MIN, WHITE_LEVEL, WHITE_SHARE = 1.0, 247, 0.1


def look_at_parts(pictures: Sequence[Image], lens: CameraModel, hidden: Sequence[NDArray[np.float64]] = ()) -> Plane:
    """Return the logarithms of energy and grey level of each part of a view, infinite where it cannot be judged.

    Args:
        pictures: As for `look_at`.
        lens: The camera model at their resolution.
        hidden: Outlines in their pixels of what does not belong to the background, such as targets.
    """
    (one, other), small = average_in_two(pictures, lens)
    fine = [each - cv2.GaussianBlur(each, (0, 0), 1.0) for each in (one, other)]
    covered = np.where(one > WHITE_LEVEL, 1.0, 0.0).astype(np.float32)
    cover(covered, hidden, small.width_px / lens.width_px, 1)
    size = (small.width_px // PART_PX, small.height_px // PART_PX)
    planes = np.dstack([fine[0] * fine[1], one, covered])
    energy, level, share = cv2.split(cv2.resize(planes, size, interpolation=cv2.INTER_AREA))
    parts = np.log(np.maximum([energy, level], [[[0.05]], [[1.0]]]))
    return np.where(share > WHITE_SHARE, np.inf, parts).astype(np.float32)


class DirtJudge(Struct):
    """Judges one check after the other, and says something once in half an hour.

    Attributes:
        words: What is on the lens, and where on the picture; empty for nothing.
    """

    words: str = ""
    _checks: list[Plane] = field(default_factory=list)
    _least: list[Plane] = field(default_factory=list)

    def judge(self, parts: Plane) -> str:
        """Take in the parts of a view, all of them infinite in the dark; return the words."""
        self._checks.append(parts)
        if len(self._checks) == CHECKS:
            checks, self._checks = np.array(self._checks), []
            if len(self._least) == HALF_HOURS and np.isfinite(checks[:, 1]).mean() > LASTING / 2:
                self.words = _fallen(checks, np.min(self._least, axis=0))
            if not self.words:
                self._least = [*self._least, np.median(checks, axis=0)][-HALF_HOURS:]
        return self.words


def _fallen(checks: Plane, least: Plane) -> str:
    """Return where parts show less than the least that they showed before; empty for nowhere."""
    least = np.where(np.isfinite(least), least, -np.inf)  # from which nothing falls
    least[0, least[0] < np.log(ENERGY_MIN)] = -np.inf
    falls = [[_falls(*each) for each in zip(check - least, FALLS, strict=True)] for check in checks]
    is_fallen = (np.mean(falls, axis=0) >= LASTING).any(axis=0)
    count, _, boxes, middles = cv2.connectedComponentsWithStats(is_fallen.astype(np.uint8), connectivity=8)
    largest = max(range(1, count), key=lambda each: int(boxes[each, cv2.CC_STAT_AREA]), default=0)
    rows, columns = is_fallen.shape
    if not largest or not PARTS_MIN <= boxes[largest, cv2.CC_STAT_AREA] <= SHARE_MAX * is_fallen.size:
        return ""
    column, row = middles[largest]
    down = ("upper", "middle", "lower")[int(3 * (row + 0.5) / rows)]
    across = ("left", "centre", "right")[int(3 * (column + 0.5) / columns)]
    return f"dirt on the lens or something new before it, at the {down} {across} of the picture"


def _falls(change: Plane, limit: float) -> NDArray[np.bool_]:
    """Return which parts fell, relative to the middle of the picture's and to the mean of their neighbours."""
    seen = np.isfinite(change)
    known = np.clip(np.where(seen, change, 0), -3, 3).astype(np.float32)
    nearby = cv2.blur(known, NEIGHBOURS) / np.maximum(cv2.blur(seen.astype(np.float32), NEIGHBOURS), 1e-3)
    middle = np.median(known[seen]) if seen.any() else 0.0
    return np.asarray(change < np.minimum(nearby, middle) - limit)
