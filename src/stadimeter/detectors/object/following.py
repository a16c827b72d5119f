"""Following a box from picture to picture without a network: how it moved and grew since the network saw it.

Corners inside of the box are found once, in the picture that the network saw, and looked for in each later one by the
pyramidal Lucas-Kanade method (J.-Y. Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker", Intel,
2001). Always against that first picture, so nothing drifts. What does not lead back to where it began is left out
(Z. Kalal et al., "Forward-backward error", ICPR 2010), and the medians over the rest tell how the box moved and grew.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Flags, Plane, Points, Profiles, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import Region, grey_of

# The box's longer side in the reduced picture in which it is followed. A growth of 1 % moves corners at its ends by a
# third of a pixel then, and they are found to a tenth. At 96 px it took twice as long and was no better.
FOLLOWED_PX = 64

# A small box is enlarged by no more than this: corners are no nearer to each other than 4 reduced pixels, and a person
# who is 24 px tall has none too many.
MAX_ENLARGED = 2.5

# The part of the box, from its middle on, in which corners are taken: beyond it is mostly background.
INNER_SHARE = 0.8

# How far around the box the later picture is looked at, in shares of its longer side.
REACH_SHARE = 0.3

# The side of the square in which it is looked for then.
VIEW_PX = math.ceil(FOLLOWED_PX * (1 + 2 * REACH_SHARE)) + 2

MAX_CORNERS = 24
MIN_CORNERS = 8

# Corners that do not lead back, or do not move as the box does, by more than this many reduced pixels.
MAX_ASTRAY_PX = 1.5

# Fewer of the corners than this share that move alike are no box.
MIN_SHARE = 0.4

# The box may grow or shrink by this factor since the network saw it: at 3 m, 1 m nearer.
MAX_GROWTH = 1.5

_WINDOW, _LEVELS = (11, 11), 2
_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.03)


class BoxPlace(NamedTuple):
    """Place of a box: its centre, and its size as a factor of that which the network saw."""

    centre_px: tuple[float, float]
    growth: float = 1.0


class ReducedView(NamedTuple):
    """A part of a picture, reduced, in the upper left of a square; the rest repeats its last pixels."""

    grey: Plane
    left_top_px: Points
    scale: Points

    def reduce(self, points_px: Points) -> Points:
        """Return where points of the picture are in it."""
        return np.asarray((points_px - self.left_top_px) * self.scale)

    def enlarge(self, points: Points) -> Points:
        """Return where points in it are in the picture."""
        return np.asarray(points / self.scale + self.left_top_px)


class BoxPattern(Struct, frozen=True, kw_only=True, eq=False):
    """The look of a box when the network saw it.

    Attributes:
        long_px: Its longer side.
        view: The picture around it.
        corners: Corners in that, shape ``(n, 2)``.
        around_px: The same in pixels of the picture, from the centre of the box.
    """

    long_px: float
    view: ReducedView
    corners: Points
    around_px: Points


class FollowedBox(NamedTuple):
    """Place of a box now, and the standard deviation of its growth, as a share."""

    place: BoxPlace
    growth_sigma: float


def take_pattern(image: Image, corners_px: Values) -> BoxPattern | str:
    """Return the pattern of a box to follow, given by left, top, right and bottom; or why nothing can be followed."""
    centre, half = (corners_px[:2] + corners_px[2:]) / 2, (corners_px[2:] - corners_px[:2]) / 2
    long_px = float(2 * half.max())
    view = _view(image, BoxPlace((float(centre[0]), float(centre[1]))), long_px)
    if view is None:
        return "it is outside of the picture"
    ends = np.stack((centre - INNER_SHARE * half, centre + INNER_SHARE * half))
    (left, top), (right, bottom) = view.reduce(ends).round().astype(int).clip(0)
    mask = np.zeros_like(view.grey)
    mask[top:bottom, left:right] = 255
    found = cv2.goodFeaturesToTrack(view.grey, MAX_CORNERS, 0.01, 4, mask=mask)
    corners = np.empty((0, 2)) if found is None else np.asarray(found, np.float64).reshape(-1, 2)
    if len(corners) < MIN_CORNERS:
        return f"it has {len(corners)} corners to be followed by, limit {MIN_CORNERS}"
    return BoxPattern(long_px=long_px, view=view, corners=corners, around_px=view.enlarge(corners) - centre)


def follow_box(image: Image, pattern: BoxPattern, near: BoxPlace) -> FollowedBox | str:
    """Return where the box is now, looked for around a place; or why it is not there."""
    view = _view(image, near, pattern.long_px)
    if view is None:
        return "it would be outside of the picture"
    first = pattern.corners.astype(np.float32)
    start = view.reduce(near.growth * pattern.around_px + near.centre_px).astype(np.float32)
    seen, is_seen = _flow(pattern.view.grey, view.grey, first, start)
    back, is_back = _flow(view.grey, pattern.view.grey, seen, first)
    good = is_seen & is_back & (np.abs(back - first).max(axis=1) < MAX_ASTRAY_PX)
    enough = max(MIN_CORNERS, MIN_SHARE * len(good))
    if good.sum() < enough:
        return f"{good.sum()} of {len(good)} corners in it are found again, limit {enough:.0f}"
    before, now = pattern.around_px[good], view.enlarge(seen[good].astype(np.float64))
    growth, sigma, is_alike = _growth(before, now, MAX_ASTRAY_PX / float(view.scale.min()))
    if is_alike.sum() < enough:
        return f"{is_alike.sum()} of {len(good)} corners in it move alike, limit {enough:.0f}"
    if not 1 / MAX_GROWTH < growth < MAX_GROWTH:
        return f"it is {growth:.2f} times as large as the network saw it, limit {MAX_GROWTH:g}"
    x_px, y_px = np.median((now - growth * before)[is_alike], axis=0).tolist()
    return FollowedBox(BoxPlace((x_px, y_px), growth), sigma)


def _view(image: Image, near: BoxPlace, long_px: float) -> ReducedView | None:
    """Return the picture around a box, reduced so that this has the size in which it is followed."""
    size_px = long_px * near.growth
    region = Region.around(near.centre_px, (0.5 + REACH_SHARE) * size_px, image)
    if region is None:
        return None
    part, scale = region.of(image), min(MAX_ENLARGED, FOLLOWED_PX / size_px)
    # Halved as often as possible, which is the mean of four pixels and quick, and the rest of the way linearly.
    halvings = min(max(0, math.floor(-math.log2(scale))), min(part.shape[:2]).bit_length() - 1)
    part = part[: part.shape[0] >> halvings << halvings, : part.shape[1] >> halvings << halvings]
    columns, rows = (min(VIEW_PX, max(1, round(side * scale))) for side in (part.shape[1], part.shape[0]))
    small = part
    for _ in range(halvings):
        half = small.shape[1] // 2, small.shape[0] // 2
        small = np.asarray(cv2.resize(small, half, interpolation=cv2.INTER_AREA), np.uint8)
    grey = cv2.resize(grey_of(small), (columns, rows), interpolation=cv2.INTER_LINEAR)
    # The method takes two pictures of one size only.
    grey = cv2.copyMakeBorder(grey, 0, VIEW_PX - rows, 0, VIEW_PX - columns, cv2.BORDER_REPLICATE)
    exact = np.array((columns / part.shape[1], rows / part.shape[0]))
    return ReducedView(np.asarray(grey, np.uint8), region.left_top_px, exact)


def _flow(one: Plane, other: Plane, points: Profiles, start: Profiles) -> tuple[Profiles, Flags]:
    """Return where points of one picture are in another one, looked for around a start, and which were found."""
    found, is_found, _ = cv2.calcOpticalFlowPyrLK(
        one, other, points, start.copy(), winSize=_WINDOW, maxLevel=_LEVELS, criteria=_STEPS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(found, np.float32), is_found.ravel() > 0


def _growth(before: Points, now: Points, astray_px: float) -> tuple[float, float, Flags]:
    """Return by which factor points moved apart, its standard deviation, and which points moved alike.

    The factor is the median over the pairs of points that are farther apart than most.
    """
    one, other = np.triu_indices(len(before), 1)
    apart = np.hypot(*(before[one] - before[other]).T)
    far = apart >= np.median(apart)
    growth = float(np.median(np.hypot(*(now[one] - now[other]).T)[far] / apart[far]))
    off = now - growth * before
    off_px = np.hypot(*(off - np.median(off, axis=0)).T)
    is_alike = off_px < astray_px
    alike = before[is_alike]
    if not len(alike):
        return growth, math.inf, is_alike
    # Least squares: each coordinate errs by σ, the growth by σ / √(sum of the squared distances from the middle).
    spread = float(((alike - alike.mean(axis=0)) ** 2).sum())
    return growth, math.sqrt(float((off_px[is_alike] ** 2).mean()) / 2 / max(spread, 1e-9)), is_alike
