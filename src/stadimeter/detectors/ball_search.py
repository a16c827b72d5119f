"""Where in a picture a ball may be: blobs of its colour, found in every fourth pixel.

Most of a picture is not the ball. Leaving out pixels, not averaging them, costs a thirteenth of a proper reduction, and
each pixel that is left keeps its colour. How large the ball is comes later, from all pixels along its limb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.circle_fit import Circle
from stadimeter.detectors.hsv_range import HsvRange
from stadimeter.detectors.region import Region

SMALLEST_SEARCHED_RADIUS_PX = 1.25
"""Pixels are left out only as long as the smallest accepted ball still has this radius in what remains."""

GREATEST_STEP = 8

MOST_BLOBS = 16
"""How many blobs are looked at: the largest."""

MOST_POINTS = 60
"""How many points of an outline are used where fewer will do: evenly spaced ones."""

GRID = 16
"""So many pixels each way say how much of a circle has the ball's colour."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Blob:
    """Pixels of the ball's colour that hang together.

    Attributes:
        circle: The circle around which its limb may be: as wide or as high as the blob, whichever is more.
        contour: Its outline as OpenCV has it, in pixels of the thinned part of the picture.
        step: Every so manieth pixel of that was looked at.
        origin_px: Where that part begins in the picture, x and y.
    """

    circle: Circle
    contour: cv2.typing.MatLike
    step: int
    origin_px: tuple[int, int]

    @property
    def size_px(self) -> float:
        """The larger of its width and its height."""
        return 2 * self.circle.radius_px

    @property
    def area_px2(self) -> float:
        """Its area."""
        return float(cv2.contourArea(self.contour)) * self.step**2

    @property
    def outline_px(self) -> Points:
        """Points along its outline, shape ``(n, 2)``."""
        return np.asarray(self.contour, np.float64).reshape(-1, 2) * self.step + self.origin_px

    @property
    def thinned_px(self) -> Points:
        """No more than `MOST_POINTS` points of its outline, evenly spaced."""
        outline_px = self.outline_px
        return outline_px[:: max(1, math.ceil(len(outline_px) / MOST_POINTS))]


def search_step(min_radius_px: float) -> int:
    """Return the k of "every k-th pixel"."""
    return max(1, min(GREATEST_STEP, int(min_radius_px / SMALLEST_SEARCHED_RADIUS_PX)))


def find_blobs(image: Image, colour: HsvRange, step: int, region: Region | None = None) -> list[Blob]:
    """Find the largest blobs of a colour.

    Args:
        image: The picture, three channels.
        colour: The colour.
        step: Only every so manieth pixel is looked at, each way.
        region: The part of the picture to look at; None for all of it.

    Returns:
        `MOST_BLOBS` at most, the largest first.
    """
    region = region or Region.whole(image)
    contours, _ = cv2.findContours(
        colour.mask(thinned(region.of(image), step)), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    boxed = [(contour, cv2.boundingRect(contour)) for contour in contours]
    boxed.sort(key=lambda pair: (-max(pair[1][2:]), pair[1]))
    return [_blob(contour, box, step, region.left, region.top) for contour, box in boxed[:MOST_BLOBS]]


def thinned(image: Image, step: int) -> Image:
    """Return every k-th pixel of every k-th row."""
    if step == 1:
        return image
    height, width = image.shape[:2]
    # OpenCV's nearest neighbour takes the first pixel of each cell, and is four times as fast as slicing and copying.
    whole = image[: height - height % step or height, : width - width % step or width]
    size = (max(1, width // step), max(1, height // step))
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_NEAREST), np.uint8)


def colour_share(image: Image, circle: Circle, colour: HsvRange) -> float:
    """Return how much of a circle has a colour, from a grid of pixels in the square within it, 0 to 1.

    Args:
        image: The picture.
        circle: The circle; what is outside of the picture does not count.
        colour: The colour.
    """
    half_px = max(1.0, circle.radius_px * math.sqrt(0.5))
    left, top = max(int(circle.x_px - half_px), 0), max(int(circle.y_px - half_px), 0)
    right, bottom = max(int(circle.x_px + half_px + 1), 0), max(int(circle.y_px + half_px + 1), 0)
    part = image[top:bottom, left:right]
    if part.size == 0:
        return 0.0
    grid = np.asarray(cv2.resize(part, (GRID, GRID), interpolation=cv2.INTER_NEAREST), np.uint8)
    return cv2.countNonZero(colour.mask(grid)) / (GRID * GRID)


def _blob(contour: cv2.typing.MatLike, box: cv2.typing.Rect, step: int, left: int, top: int) -> Blob:
    x, y, width, height = box
    # The pixel that was looked at is the first of its cell; the blob reaches half a cell beyond it on average.
    circle = Circle(
        x_px=left + (x + (width - 1) / 2) * step,
        y_px=top + (y + (height - 1) / 2) * step,
        radius_px=max(width, height) * step / 2,
    )
    return Blob(circle=circle, contour=contour, step=step, origin_px=(left, top))
