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

# The box's longer side in the reduced picture in which it is followed. At 96 px a growth of 1 % moves the corners at
# its ends by half a pixel, and they are found to a tenth; at twice the size it takes three times as long.
FOLLOWED_PX = 96

# The part of the box, from its middle on, in which corners are taken: beyond it is mostly background.
INNER_SHARE = 0.8

# How far around the box the later picture is looked at, in shares of its longer side.
REACH_SHARE = 0.35

MAX_CORNERS = 32
MIN_CORNERS = 8

# Corners that do not lead back, or do not move as the box does, by more than this many reduced pixels.
MAX_ASTRAY_PX = 1.5

# Fewer of the corners than this share that move alike are no box.
MIN_SHARE = 0.4

# The box may grow or shrink by this factor since the network saw it: at 3 m, 1 m nearer.
MAX_GROWTH = 1.5

_WINDOW, _LEVELS = (13, 13), 2
_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 15, 0.03)


class BoxPlace(NamedTuple):
    """Where a box is: its centre, and its size as a factor of that which the network saw."""

    centre_px: tuple[float, float]
    growth: float = 1.0


class BoxPattern(Struct, frozen=True, kw_only=True, eq=False):
    """What a box looked like when the network saw it.

    Attributes:
        centre_px: Its centre.
        long_px: Its longer side.
        grey: The picture around it, reduced.
        corners: Corners in that, shape ``(n, 2)``.
        middle: The centre of the box in that.
    """

    centre_px: tuple[float, float]
    long_px: float
    grey: Plane
    corners: Points
    middle: Points


class FollowedBox(NamedTuple):
    """Where a box is now, and the standard deviation of its growth, as a share."""

    place: BoxPlace
    growth_sigma: float


def take_pattern(image: Image, corners_px: Values) -> BoxPattern | str:
    """Return what is to be followed of a box, given by left, top, right and bottom; or why nothing can be."""
    centre = (corners_px[:2] + corners_px[2:]) / 2
    long_px = float((corners_px[2:] - corners_px[:2]).max())
    place = float(centre[0]), float(centre[1])
    view = _view(image, BoxPlace(place), long_px)
    if view is None:
        return "it is outside of the picture"
    grey, left_top, scale = view
    mask = np.zeros_like(grey)
    half = INNER_SHARE / 2 * (corners_px[2:] - corners_px[:2])
    low, high = ((edge - left_top) * scale for edge in (centre - half, centre + half))
    (left, top), (right, bottom) = low.round().astype(int).clip(0), high.round().astype(int).clip(0)
    mask[top:bottom, left:right] = 255
    corners = cv2.goodFeaturesToTrack(grey, MAX_CORNERS, 0.01, 5, mask=mask)
    count = 0 if corners is None else len(corners)
    if count < MIN_CORNERS:
        return f"it has {count} corners to be followed by, limit {MIN_CORNERS}"
    return BoxPattern(
        centre_px=place,
        long_px=long_px,
        grey=grey,
        corners=np.asarray(corners, np.float64).reshape(-1, 2),
        middle=np.asarray((centre - left_top) * scale, np.float64),
    )


def follow_box(image: Image, pattern: BoxPattern, near: BoxPlace) -> FollowedBox | str:
    """Return where the box is now, looked for around a place; or why it is not there."""
    view = _view(image, near, pattern.long_px)
    if view is None:
        return "it would be outside of the picture"
    grey, left_top, scale = view
    # Reduced so that the box is as large as in its pattern, if it has grown as expected; its centre is expected here.
    expected = (np.array(near.centre_px) - left_top) * scale
    start = (pattern.corners - pattern.middle + expected).astype(np.float32)
    first = pattern.corners.astype(np.float32)
    seen, is_seen = _flow(pattern.grey, grey, first, start)
    back, is_back = _flow(grey, pattern.grey, seen, first)
    good = is_seen & is_back & (np.abs(back - first).max(axis=1) < MAX_ASTRAY_PX)
    if good.sum() < max(MIN_CORNERS, MIN_SHARE * len(good)):
        return f"{good.sum()} of {len(good)} corners in it are found again, limit {MIN_SHARE:.0%}"
    before, now = (each[good].astype(np.float64) for each in (first, seen))
    growth, growth_sigma, is_alike = _growth(before - pattern.middle, now)
    if is_alike.sum() < max(MIN_CORNERS, MIN_SHARE * len(good)):
        return f"{is_alike.sum()} of {len(good)} corners in it move alike, limit {MIN_SHARE:.0%}"
    middle = np.median(now - growth * (before - pattern.middle), axis=0) / scale + left_top
    growth *= near.growth
    if not 1 / MAX_GROWTH < growth < MAX_GROWTH:
        return f"it is {growth:.2f} times as large as the network saw it, limit {MAX_GROWTH:g}"
    return FollowedBox(BoxPlace((float(middle[0]), float(middle[1])), growth), growth_sigma)


def _view(image: Image, near: BoxPlace, long_px: float) -> tuple[Plane, Points, float] | None:
    """Return the picture around a box, reduced, with its first edge in the picture and its scale."""
    size_px = long_px * near.growth
    region = Region.around(near.centre_px, (0.5 + REACH_SHARE) * size_px, image)
    if region is None:
        return None
    part = region.of(image)
    scale = min(1.0, FOLLOWED_PX / size_px)
    size = tuple(max(1, round(side * scale)) for side in (part.shape[1], part.shape[0]))
    grey = grey_of(np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8))
    return grey, region.left_top_px, scale


def _flow(one: Plane, other: Plane, points: Profiles, start: Profiles) -> tuple[Profiles, Flags]:
    """Return where points of one picture are in another one, looked for around a start, and which were found."""
    found, is_found, _ = cv2.calcOpticalFlowPyrLK(
        one, other, points, start.copy(), winSize=_WINDOW, maxLevel=_LEVELS, criteria=_STEPS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(found, np.float32), is_found.ravel() > 0


def _growth(before: Points, now: Points) -> tuple[float, float, Flags]:
    """Return by which factor points moved apart, its standard deviation, and which points moved alike.

    The factor is the median over all pairs of points that are far enough apart to tell.
    """
    one, other = np.triu_indices(len(before), 1)
    apart = np.hypot(*(before[one] - before[other]).T)
    far = apart >= np.median(apart)
    growth = float(np.median(np.hypot(*(now[one] - now[other]).T)[far] / apart[far]))
    off = now - growth * before
    off_px = np.hypot(*(off - np.median(off, axis=0)).T)
    is_alike = off_px < MAX_ASTRAY_PX
    # Least squares: each coordinate errs by σ, and the growth by σ / √(sum of the squared distances from the middle).
    spread = before[is_alike] - before[is_alike].mean(axis=0) if is_alike.any() else before
    sigma = math.sqrt(float((off_px[is_alike] ** 2).mean()) / 2) if is_alike.any() else math.inf
    return growth, sigma / math.sqrt(max(float((spread**2).sum()), 1e-9)), is_alike
