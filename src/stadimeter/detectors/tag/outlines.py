"""Outlines of four corners in a picture, which may be those of tags.

`cv2.aruco` finds them, and compares each with each: a fine chequer of ten thousand squares would take it minutes. So
where outlines are many, only the largest are looked for. It also keeps every contour of a picture, however short: for
50 megapixels of noise OpenCV 4.10 took 10 GB, OpenCV 5 1.2 GB. So noise is looked through with one window size, and at
half its size where only large outlines are left to look for.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.detectors.sampling import reduced, to_full_scale

Plane = NDArray[np.uint8]

# Pixels are compared with the mean of a square around them; one size is enough for most tags.
ONE_WINDOW = (13, 13)

# OpenCV's own choice: squares of 3, 13 and 23 pixels.
THREE_WINDOWS = (3, 23)

# No tag fits into a smaller picture.
MIN_PICTURE_PX = 8

# Outlines whose corners are all nearer to each other are one.
SAME_PX = 1.5

# A direction, and how far apart along it the centres of two outlines that are one may be.
OBLIQUE = np.array((0.8, 0.6))
NEAR_PX = SAME_PX * (0.8 + 0.6)

# Distance in pixels of OpenCV's outline inside the edge of a black tag: through the middles of the outermost dark
# pixels.
INSET_PX = 0.85

# The corner after each corner.
ROUND = np.array((1, 2, 3, 0))

# Number of outlines that a look may show: rooms show ten, shelves and keyboards a hundred.
MAX_OUTLINES = 250

# Outlines are counted in pictures with at least this long side; too few have room in smaller ones to matter.
COUNTED_FROM_PX = 400

# Outlines are counted at a half of the size that they are looked for at, which takes a twentieth of the time.
COUNTING_SCALE = 2

# At full size an outline is at most this many times as long as counted at half, plus a pixel a side. Without it a floor
# whose outlines are all alike would lose them all.
COUNTING_ERROR = 1.1

# A picture with more contours than this at half its size is noise: 12.5 megapixels of it have 135,000, and the busiest
# real picture that was tried 23,000 in 3 megapixels.
MAX_CONTOURS = 100_000

# Outlines of a longer perimeter than this are still found at half the size: tags of 16 px are.
HALVED_FROM_PX = 128.0

# Outlines with less than this share of the area of a square of their length are no tags, and do not count.
HOLLOW = 0.25


class TagOutlines(NamedTuple):
    """What a look found."""

    corners_px: Points  # clockwise, the largest first, shape ``(k, 4, 2)``
    left_out_px: float = 0.0  # outlines of a shorter perimeter than this were left out since there are too many


class _Crowd(NamedTuple):
    """How many outlines a picture has."""

    perimeter_px: float  # no more than `MAX_OUTLINES` outlines have a longer one; 0 if no more have the smallest one
    contours: int = 0  # how many contours there are at half the size, of any length


def find_outlines(grey: Plane, smallest_perimeter_px: float, long_side_px: int, *, thorough: bool) -> TagOutlines:
    """Return outlines of four corners that differ from what is around.

    What costs time is what is found, so small ones are left out early: OpenCV's limit is a share of the picture's long
    side and its default, 0.03, means nothing in a small part of a picture.

    Args:
        smallest_perimeter_px: TagOutlines that are shorter than this around are left out.
        long_side_px: The picture is searched with its long side reduced to this.
        thorough: Whether three window sizes are tried instead of one, but for noise.
    """
    nothing = np.zeros((0, 4, 2))
    if min(grey.shape) < MIN_PICTURE_PX:
        return TagOutlines(nothing)
    small, scale = reduced(grey, long_side_px, cv2.INTER_LINEAR)
    crowd = _crowd(small, smallest_perimeter_px * scale)
    crowded_px = crowd.perimeter_px / scale
    is_noise = crowd.contours > MAX_CONTOURS
    if is_noise and crowd.perimeter_px > HALVED_FROM_PX:
        small, half = reduced(small, max(small.shape) // 2, cv2.INTER_LINEAR)
        scale *= half
    # OpenCV's limit is a share of the long side of the picture that it is given.
    rate = max(smallest_perimeter_px, crowded_px) * scale / max(small.shape)
    parameters = _parameters(THREE_WINDOWS if thorough and not is_noise else ONE_WINDOW, rate)
    named, _, others = cv2.aruco.ArucoDetector(_no_dictionary(), parameters).detectMarkers(small)
    found = (*named, *others)
    outlines = distinct(_around_dark(np.concatenate(found), scale)) if found else nothing
    return TagOutlines(outlines[:MAX_OUTLINES], crowded_px)


def _crowd(grey: Plane, smallest_perimeter_px: float) -> _Crowd:
    if max(grey.shape) < COUNTED_FROM_PX:
        return _Crowd(0.0)
    half, scale = reduced(grey, max(grey.shape) // COUNTING_SCALE, cv2.INTER_LINEAR)
    window, below = ONE_WINDOW[0] // COUNTING_SCALE | 1, _parameters(ONE_WINDOW, 0.0).adaptiveThreshConstant
    dark = cv2.adaptiveThreshold(half, 1, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, window, below)
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    # The number of points of a contour is its length, from pixel to pixel.
    long = [each for each in contours if len(each) > scale * smallest_perimeter_px]
    if len(long) <= MAX_OUTLINES:
        return _Crowd(0.0, len(contours))
    full = [len(each) for each in long if cv2.contourArea(each) > HOLLOW * (len(each) / 4) ** 2]
    if len(full) <= MAX_OUTLINES:
        return _Crowd(0.0, len(contours))
    return _Crowd(COUNTING_ERROR * (sorted(full, reverse=True)[MAX_OUTLINES] + 4) / scale, len(contours))


def _around_dark(corners: NDArray[np.float32], scale: float) -> Points:
    """Return where outlines of a reduced picture lead around what is dark, in the full picture, the largest first."""
    around_px = np.abs(corners.take(ROUND, axis=1) - corners).reshape(-1, 8).sum(axis=1, dtype=np.float64)
    # Of a square, each edge is an eighth of the way around from the centre, so moving the edges out by INSET_PX
    # stretches it by this factor. Other shapes of outlines are near enough: they are measured anew.
    growth = (1 + 8 * INSET_PX / around_px) / scale
    centre = corners.sum(axis=1, keepdims=True) / 4
    grown = to_full_scale(centre, scale) + (corners - centre) * growth[:, None, None]
    return np.asarray(grown if len(grown) == 1 else grown[np.argsort(-around_px, kind="stable")])


def _parameters(windows: tuple[int, int], rate: float) -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = windows
    parameters.minMarkerPerimeterRate = max(rate, 1e-3)
    parameters.minDistanceToBorder = 0
    # OpenCV reads the code too, of every outline; with one pixel a cell that costs least, and nothing is made of it.
    parameters.perspectiveRemovePixelPerCell = 1
    # An outline inside another, such as a tag on its paper, would hide behind it.
    parameters.minMarkerDistanceRate = 0.0
    return parameters


@cache
def _no_dictionary() -> cv2.aruco.Dictionary:
    """Return a dictionary of a single small tag: OpenCV returns what it does not recognise as well."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.Dictionary(np.asarray(family.bytesList)[:1], family.markerSize, 0)


def distinct(outlines: Points) -> Points:
    """Leave out what was found twice: of two outlines that are one, the later, shape ``(k, 4, 2)``.

    Only neighbours along an oblique line are compared: a table of all with all would fill the memory where a floor or a
    grille shows thousands. The line is oblique since their rows and columns would meet in one place of an axis.
    """
    if len(outlines) == 1:
        return outlines
    along = outlines.mean(axis=1) @ OBLIQUE
    order = np.argsort(along)
    along = along[order]
    is_left = np.ones(len(outlines), np.bool_)
    # Neighbours in the order along that line, then those two places apart, and so on until none are near any more.
    for step in range(1, len(outlines)):
        near = np.flatnonzero(along[step:] - along[:-step] < NEAR_PX)
        if not len(near):
            break
        one, other = order[near], order[near + step]
        is_same = np.abs(outlines[one] - outlines[other]).reshape(-1, 8).max(axis=1) < SAME_PX
        is_left[np.maximum(one, other)[is_same]] = False
    return outlines[is_left]
