"""Candidates for a sheet: every convex outline of four corners that some binarisation of a picture shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.quad_shape import polygon_area

Mask = NDArray[np.uint8]

OUTLINE_TOLERANCES = (0.01, 0.02, 0.035, 0.05)
"""How far corners may be from the outline, as shares of its length, tried in this order until four are left."""

CANNY_THRESHOLDS = ((20, 60), (50, 150))
"""Gradients of weak and of strong edges, for a sheet that hardly differs from what is behind it and for a clear one."""


def find_quadrilaterals(image: Image, smallest_side_px: float, most: int) -> list[Points]:
    """Return the outlines of four corners in a picture, without those that are all but the same.

    Whether one of them is a sheet is not decided here.

    Args:
        image: The picture, three channels.
        smallest_side_px: Outlines that are smaller than a square of this side are left out.
        most: How many to return at most: the largest.

    Returns:
        The corners of each, shape ``(4, 2)``, in order around it; the largest first.
    """
    found: list[tuple[float, Points]] = []
    for mask in _binarisations(image):
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        for contour in contours:
            corners = _four_corners(np.asarray(contour, np.int32), smallest_side_px**2)
            if corners is not None:
                found.append((polygon_area(corners), corners))
    found.sort(key=lambda item: (-item[0], *item[1].ravel()))
    return _distinct((corners for _, corners in found), most)


def _binarisations(image: Image) -> Iterator[Mask]:
    """Yield black and white versions of a picture, each of which shows some sheets that the others miss.

    White paper on brown wood hardly differs in brightness but clearly in blue, so each channel is looked at. Splitting
    it at one level finds a sheet whose edge is blurred, edges find one under uneven light.
    """
    for index in range(image.shape[2]):
        channel = cv2.GaussianBlur(np.ascontiguousarray(image[:, :, index]), (5, 5), 0)
        _, mask = cv2.threshold(channel, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        yield np.asarray(mask, np.uint8)
        for weak, strong in CANNY_THRESHOLDS:
            edges = cv2.Canny(channel, weak, strong)
            yield np.asarray(cv2.dilate(edges, np.ones((3, 3), np.uint8)), np.uint8)


def _four_corners(contour: NDArray[np.int32], smallest_area_px2: float) -> Points | None:
    """Return the corners of the hull of a contour if it has four; a finger over an edge does not matter."""
    _, _, width, height = cv2.boundingRect(contour)
    if width * height < smallest_area_px2:
        return None
    hull = cv2.convexHull(contour)
    if cv2.contourArea(hull) < smallest_area_px2:
        return None
    length = cv2.arcLength(hull, closed=True)
    for tolerance in OUTLINE_TOLERANCES:
        polygon = np.asarray(cv2.approxPolyDP(hull, tolerance * length, closed=True))
        if len(polygon) == 4:
            return polygon.reshape(4, 2).astype(np.float64)
        if len(polygon) < 4:
            return None
    return None


def _distinct(outlines: Iterable[Points], most: int) -> list[Points]:
    """Leave out outlines whose corners all lie close to those of one before."""
    kept = np.empty((most, 4, 2))
    count = 0
    for corners in outlines:
        ordered = _in_standard_order(corners)
        near = 0.02 * float(np.sqrt(polygon_area(ordered))) + 1.0
        if (np.abs(kept[:count] - ordered).max(axis=(1, 2)) > near).all():
            kept[count] = ordered
            count += 1
        if count == most:
            break
    return list(kept[:count])


def _in_standard_order(corners: Points) -> Points:
    """Return the corners clockwise on the screen, starting with the one that is nearest to the top left."""
    centre = corners.mean(axis=0)
    angles = np.arctan2(corners[:, 1] - centre[1], corners[:, 0] - centre[0])
    clockwise = corners[np.argsort(angles)]
    return np.roll(clockwise, -int(np.argmin(clockwise.sum(axis=1))), axis=0)
