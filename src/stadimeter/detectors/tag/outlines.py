"""Outlines of four corners that may be tags, found by `cv2.aruco`; and small tags by the AprilTag library."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.detectors.sampling import reduced, to_full_scale
from stadimeter.detectors.tag.codes import SMALL_TAG_FAMILIES, SeenTag

Plane = NDArray[np.uint8]

ONE_WINDOW = (13, 13)
"""Pixels are compared with the mean of a square around them; one size is enough for most tags."""

THREE_WINDOWS = (3, 23)
"""OpenCV's own choice: squares of 3, 13 and 23 pixels."""

LEAST_PICTURE_PX = 8
"""No tag fits into a smaller picture."""

SAME_PX = 1.5
"""Outlines whose corners are all nearer to each other are one."""

OBLIQUE = np.array((0.8, 0.6))
NEAR_PX = SAME_PX * (0.8 + 0.6)
"""A direction, and how far apart along it the centres of two outlines that are one may be."""

INSET_PX = 0.85
"""Distance of OpenCV's outline inside the edge of a black tag: through the middles of the outermost dark pixels."""

ROUND = np.array((1, 2, 3, 0))
"""The corner after each corner."""


def find_outlines(grey: Plane, smallest_perimeter_px: float, long_side_px: int, *, thorough: bool) -> Points:
    """Return outlines of four corners that differ from what is around, clockwise, ``(k, 4, 2)``; the largest first.

    What costs time is what is found, so small ones are left out early: OpenCV's limit is a share of the picture's long
    side and its default, 0.03, means nothing in a small part of a picture.

    Args:
        smallest_perimeter_px: Outlines that are shorter than this around are left out.
        long_side_px: The picture is searched with its long side reduced to this.
        thorough: Whether three window sizes are tried instead of one.
    """
    if min(grey.shape) < LEAST_PICTURE_PX:
        return np.zeros((0, 4, 2))
    small, scale = reduced(grey, long_side_px, cv2.INTER_LINEAR)
    rate = smallest_perimeter_px * scale / max(small.shape)
    parameters = _parameters(THREE_WINDOWS if thorough else ONE_WINDOW, rate)
    named, _, others = cv2.aruco.ArucoDetector(_no_dictionary(), parameters).detectMarkers(small)
    found = (*named, *others)
    if not found:
        return np.zeros((0, 4, 2))
    return distinct(_around_dark(np.concatenate(found), scale))


def _around_dark(corners: NDArray[np.float32], scale: float) -> Points:
    """Return where outlines of a reduced picture lead around what is dark, in the full picture, the largest first."""
    around_px = np.abs(corners.take(ROUND, axis=1) - corners).reshape(-1, 8).sum(axis=1, dtype=np.float64)
    # Of a square, each edge is an eighth of the way around from the centre.
    growth = (1 + 8 * INSET_PX / around_px) / scale
    centre = corners.sum(axis=1, keepdims=True) / 4
    grown = to_full_scale(centre, scale) + (corners - centre) * growth[:, None, None]
    return np.asarray(grown if len(grown) == 1 else grown[np.argsort(-around_px, kind="stable")])


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
    for step in range(1, len(outlines)):
        near = np.flatnonzero(along[step:] - along[:-step] < NEAR_PX)
        if not len(near):
            break
        one, other = order[near], order[near + step]
        is_same = np.abs(outlines[one] - outlines[other]).reshape(-1, 8).max(axis=1) < SAME_PX
        is_left[np.maximum(one, other)[is_same]] = False
    return outlines[is_left]


LEAST_MARGIN = 20.0
"""Least difference of the cells from the threshold between black and white, in levels: noise reaches about 10."""


class ApriltagFinder:
    """Finds small AprilTags, of 16 to 24 pixels, with their authors' own library.

    It takes several times as long as `find_outlines`, and raises an `ImportError` without the extra ``tags``.
    """

    def __init__(self, family: str) -> None:
        import pyapriltags  # noqa: PLC0415 - an optional library

        self._detector = pyapriltags.Detector(families=SMALL_TAG_FAMILIES[family], nthreads=1, quad_decimate=1.0)

    def find(self, grey: Plane) -> list[SeenTag]:
        """Return the tags of the family in a picture."""
        if min(grey.shape) < LEAST_PICTURE_PX:
            return []
        return [
            SeenTag(number=int(tag.tag_id), errors=int(tag.hamming), corners_px=_clockwise(tag.corners))
            for tag in self._detector.detect(grey)
            if tag.decision_margin >= LEAST_MARGIN
        ]


def _clockwise(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return corners that come anticlockwise from the bottom left clockwise from the top left.

    The library has (0, 0) at the corner of the first pixel instead of at its centre.
    """
    return np.asarray(corners[::-1] - 0.5, np.float64)
