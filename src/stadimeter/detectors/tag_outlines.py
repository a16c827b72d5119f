"""Outlines of four corners that may be tags, found by `cv2.aruco`."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.detectors.sampling import to_full_scale

Plane = NDArray[np.uint8]

ONE_WINDOW = (13, 13)
"""Pixels are compared with the mean of a square around them; one size is enough for most tags."""

THREE_WINDOWS = (3, 23)
"""OpenCV's own choice: squares of 3, 13 and 23 pixels."""

LEAST_PICTURE_PX = 8
"""No tag fits into a smaller picture."""

SAME_PX = 1.5
"""Outlines whose corners are all nearer to each other are one."""


def find_outlines(grey: Plane, smallest_perimeter_px: float, long_side_px: int, *, thorough: bool) -> list[Points]:
    """Return the outlines of four corners that are darker or brighter than what is around them.

    What costs time is what is found, so small ones are left out early: OpenCV's limit is a share of the picture's long
    side and its default, 0.03, means nothing in a small part of a picture.

    Args:
        grey: The picture, shape ``(height, width)``.
        smallest_perimeter_px: Outlines that are shorter than this around are left out.
        long_side_px: The picture is searched with its long side reduced to this.
        thorough: Whether three window sizes are tried instead of one.

    Returns:
        The corners of each, clockwise on the screen, shape ``(4, 2)``; the largest first.
    """
    if min(grey.shape) < LEAST_PICTURE_PX:
        return []
    small, scale = _reduced(grey, long_side_px)
    rate = smallest_perimeter_px * scale / max(small.shape)
    parameters = _parameters(THREE_WINDOWS if thorough else ONE_WINDOW, rate)
    named, _, others = cv2.aruco.ArucoDetector(_no_dictionary(), parameters).detectMarkers(small)
    corners = np.array([*named, *others], np.float64).reshape(-1, 4, 2)
    return _distinct(to_full_scale(corners, scale))


def _reduced(grey: Plane, long_side_px: int) -> tuple[Plane, float]:
    """Return the picture at a smaller size, and its scale: half of it as means of four pixels, anything else sooner."""
    height, width = grey.shape
    scale = min(1.0, long_side_px / max(height, width))
    if scale == 1.0:
        return grey, scale
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR), np.uint8), scale


def _parameters(windows: tuple[int, int], rate: float) -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = windows
    parameters.minMarkerPerimeterRate = max(rate, 1e-3)
    parameters.minDistanceToBorder = 0
    parameters.perspectiveRemovePixelPerCell = 1
    # An outline inside another, such as a tag on its paper, would hide behind it.
    parameters.minMarkerDistanceRate = 0.0
    return parameters


@cache
def _no_dictionary() -> cv2.aruco.Dictionary:
    """Return a dictionary of a single small tag: OpenCV returns what it does not recognise as well."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.Dictionary(np.asarray(family.bytesList)[:1], family.markerSize, 0)


def _distinct(outlines: Points) -> list[Points]:
    """Leave out what was found twice, and put the largest first."""
    around = np.abs(outlines[:, [1, 2, 3, 0]] - outlines).sum(axis=(1, 2))
    ordered = outlines[np.argsort(-around, kind="stable")]
    apart = np.abs(ordered[:, None] - ordered).max(axis=(2, 3))
    repeated = (np.tril(apart < SAME_PX, -1)).any(axis=1)
    return list(ordered[~repeated])
