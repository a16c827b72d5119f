"""Outlines in a picture that may be those of discs.

The picture is parted at several levels of brightness. What is bright of it or dark may be a disc; whether it is shaped
like one is seen from its area and its second moments, which an ellipse has in a fixed proportion, and from how far its
outline lies from the ellipse with these moments.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.detectors.ellipse_shape import Ellipse, ellipse_from_moments

Plane = NDArray[np.uint8]
Contour = NDArray[np.int32]

LEVELS = 10
"""A disc is found if one of these levels lies between it and all that is around it."""

LEAST_RANGE = 6
"""A picture whose brightest and darkest values differ by less holds nothing."""

SMOOTH = 3
"""Noise is smoothed over so many pixels, or else every level would have thousands of specks."""

COMPACT = 0.5
"""The least area of an outline that is measured, as a share of that of a circle with its length."""

LEAST_FILL = 0.93
"""The least area of an outline, as a share of that of the ellipse with its moments: a square has 0.955."""

LEAST_ASPECT = 0.2
"""Flatter outlines are not looked at; the limit for a disc is told from its measured outline."""

OFF_PX, OFF_SHARE = 0.8, 0.025
"""How far an outline may lie from its ellipse, root mean square: in pixels, and as a share of the mean half axis."""

SAME_PLACE, SAME_SIZE = 0.2, 0.15
"""Outlines are one if their centres are nearer than this share of the size, and their sizes differ by less."""

MOST_LOOKED_AT = 40
"""Of outlines that are no ellipses, only the largest are looked at."""


class Shape(NamedTuple):
    """What is brighter or darker than a level.

    Attributes:
        contour: The pixels of its outline, shape ``(n, 1, 2)``.
        area: The area within, in px².
        is_bright: Whether it is brighter than what is around it.
    """

    contour: Contour
    area: float
    is_bright: bool


class Outline(NamedTuple):
    """A shape beside the ellipse that it is most like.

    Attributes:
        shape: The shape.
        ellipse: The ellipse.
        size_px: The larger diameter of the ellipse.
        fill: The area of the shape, as a share of that of the ellipse.
        off_px: How far the outline lies from the ellipse, root mean square; infinite if it is flat or hollow.
        seen: At how many levels it was seen.
    """

    shape: Shape
    ellipse: Ellipse
    size_px: float
    fill: float
    off_px: float
    seen: int = 1

    @property
    def promise(self) -> float:
        """How much it may stand out as a disc: a root of contrast times size, times how round it is."""
        larger, smaller, _ = self.ellipse.axes()
        return math.sqrt(self.seen * larger) * smaller / larger

    @property
    def is_elliptical(self) -> bool:
        """Whether nearly all of it lies on the ellipse."""
        return self.off_px < most_off_px(self.ellipse)


class Outlines(NamedTuple):
    """What was found in a picture.

    Attributes:
        ellipses: What is elliptical, each of them once, the most promising first.
        others: What has another shape, at every level.
        brightness_range: By how much the brightest and the darkest value differ.
    """

    ellipses: Sequence[Outline]
    others: Sequence[Shape]
    brightness_range: int


def find_outlines(grey: Plane, least_px: float, *, bright: bool, dark: bool) -> Outlines:
    """Find what may be a disc.

    Args:
        grey: The picture, shape ``(height, width)``.
        least_px: The least larger diameter.
        bright: Whether to look for discs brighter than what is around them.
        dark: Whether to look for darker ones.

    Returns:
        The outlines.
    """
    smooth = np.asarray(cv2.blur(grey, (SMOOTH, SMOOTH)), np.uint8)
    darkest, brightest = (int(each) for each in cv2.minMaxLoc(smooth)[:2])
    if brightest - darkest < LEAST_RANGE:
        return Outlines((), (), brightest - darkest)
    ellipses: list[Outline] = []
    others: list[Shape] = []
    for level in np.linspace(darkest, brightest, LEVELS + 2)[1:-1]:
        for shape in _shapes(smooth, float(level), least_px):
            if not (bright if shape.is_bright else dark):
                continue
            outline = _outline(shape) if _is_compact(shape) else None
            if outline is not None and outline.is_elliptical:
                if outline.size_px > least_px:
                    ellipses.append(outline)
            else:
                others.append(shape)
    promising = sorted(distinct(ellipses), key=lambda each: -each.promise)
    return Outlines(ellipses=promising, others=others, brightness_range=brightest - darkest)


def largest(shapes: Iterable[Shape], count: int) -> list[Outline]:
    """Return the largest of shapes that are no ellipses, what was seen at several levels once.

    Args:
        shapes: The shapes.
        count: How many at most.
    """
    looked_at = sorted(shapes, key=lambda each: -each.area)[:MOST_LOOKED_AT]
    outlines = (_outline(each) for each in looked_at)
    return distinct([each for each in outlines if each is not None])[:count]


def most_off_px(ellipse: Ellipse) -> float:
    """Return how far the outline of an ellipse may lie from it, root mean square."""
    larger, smaller, _ = ellipse.axes()
    return max(OFF_PX, OFF_SHARE * (larger + smaller) / 2)


def root_mean_square(values: NDArray[np.float64]) -> float:
    """Return the root of the mean of squares."""
    return math.sqrt(float(values @ values) / len(values))


def _shapes(smooth: Plane, level: float, least_px: float) -> Iterator[Shape]:
    """Yield what is brighter or darker than a level and large enough.

    OpenCV goes around what is bright and around its holes in opposite ways, so the sign of the area tells them apart. A
    tree of the contours tells the same, but OpenCV takes a minute to grow it where there are a hundred thousand holes.
    """
    parted = cv2.threshold(smooth, level, 255, cv2.THRESH_BINARY)[1]
    contours, _ = cv2.findContours(parted, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    least_area = LEAST_ASPECT * math.pi / 4 * least_px**2
    for contour in contours:
        if len(contour) > 2 * least_px:
            area = cv2.contourArea(contour, oriented=True)
            if abs(area) > least_area:
                yield Shape(np.asarray(contour, np.int32), abs(area), is_bright=area < 0)


def _is_compact(shape: Shape) -> bool:
    return 4 * math.pi * shape.area > COMPACT * len(shape.contour) ** 2


def _outline(shape: Shape) -> Outline | None:
    """Return what a shape looks like as an ellipse; None for a line."""
    moments = cv2.moments(shape.contour)
    area = moments["m00"]
    centre = (moments["m10"] / area, moments["m01"] / area)
    ellipse = ellipse_from_moments(area, centre, (moments["mu20"], moments["mu11"], moments["mu02"]))
    if ellipse is None:
        return None
    larger, smaller, _ = ellipse.axes()
    fill, off_px = area / (math.pi * larger * smaller), math.inf
    if fill > LEAST_FILL and smaller > LEAST_ASPECT * larger:
        off_px = root_mean_square(ellipse.distances_px(shape.contour[:, 0].astype(np.float64)))
    return Outline(shape, ellipse, 2 * larger, fill, off_px)


def distinct(outlines: Sequence[Outline]) -> list[Outline]:
    """Return what was seen at several levels once, as it is most like an ellipse; the largest first."""
    if not outlines:
        return []
    order = sorted(outlines, key=lambda each: (not each.is_elliptical, each.off_px, -each.fill))
    places = np.array([each.ellipse.centre_px for each in order])
    sizes = np.array([each.size_px for each in order])
    shades = np.array([each.shape.is_bright for each in order])
    is_left = np.ones(len(order), np.bool_)
    kept = []
    for number, outline in enumerate(order):
        if is_left[number]:
            near = (np.abs(places - places[number]) < SAME_PLACE * sizes[number]).all(axis=1)
            alike = np.abs(sizes / sizes[number] - 1) < SAME_SIZE
            same = is_left & near & alike & (shades == shades[number])
            kept.append(outline._replace(seen=int(np.count_nonzero(same))))
            is_left &= ~same
    return sorted(kept, key=lambda each: -each.size_px)
