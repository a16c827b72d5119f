"""Blobs of a range of colours: where in a picture a ball may be.

Most of a picture is not the ball, so only every fourth pixel or so is looked at. Leaving out pixels, not averaging
them, costs a thirteenth of a proper reduction, and each pixel that is left keeps its colour. How large the ball is
comes later, from all pixels along its limb.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, lru_cache

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Indices, Points
from stadimeter.core.frame import Image
from stadimeter.detectors.hsv import HsvRange, Mask
from stadimeter.detectors.sampling import Region

# Circles through points of which many do not belong to it -------------------------------------------------------------

# With half of the points on the circle, 64 triples miss it twice in ten thousand times.
TRIES = 64

# Steps of three sequences that fill a cube evenly: powers of the root of ``x⁴ = x + 1``.
EVENLY = 1 / 1.2207440846057596 ** np.arange(1, 4)


class ImageCircle(Struct, frozen=True, kw_only=True):
    """A circle in pixels."""

    x_px: float
    y_px: float
    radius_px: float


def find_common_circle(points_px: Points) -> ImageCircle | None:
    """Find the circle within a pixel of which most of the points lie; None if no three of them form one.

    Circles through three points each are tried. The same points always give the same circle.
    """
    circles = _circles_through_triples(points_px, TRIES)
    if not len(circles):
        return None
    across, down = points_px[:, 0] - circles[:, :1], points_px[:, 1] - circles[:, 1:2]
    # Each point votes with 1 - d², none beyond a pixel (RANSAC with a truncated square as its score, MSAC: P.
    # Torr and A. Zisserman, "MLESAC", 2000).
    apart = np.sqrt(across * across + down * down) - circles[:, 2:]
    score = np.maximum(1 - apart * apart, 0.0).sum(axis=1)
    x, y, radius = (float(value) for value in circles[int(np.argmax(score))])
    return ImageCircle(x_px=x, y_px=y, radius_px=radius)


def _circles_through_triples(points: Points, tries: int) -> Points:
    """Return the circles through triples of points as x, y, radius, shape ``(m, 3)``."""
    all_x, all_y = np.ascontiguousarray(points.T)
    picks = _picks(tries, len(points))
    (x, bx, cx), (y, by, cy) = all_x.take(picks), all_y.take(picks)
    # Circumcentre of the triangle in coordinates from its first corner. Twice its signed area is the determinant;
    # nearly zero for three points on a line, which form no circle.
    bx, cx, by, cy = bx - x, cx - x, by - y, cy - y
    twice_area = 2 * (bx * cy - by * cx)
    apart = np.abs(twice_area) > 1e-6
    twice_area = np.where(apart, twice_area, 1.0)
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    to_x = (cy * b2 - by * c2) / twice_area
    to_y = (bx * c2 - cx * b2) / twice_area
    radius = np.sqrt(to_x * to_x + to_y * to_y)
    # Circles wider than the cloud of points are nearly straight lines through a few of them.
    size = max(float(all_x.max() - all_x.min()), float(all_y.max() - all_y.min()))
    circles = np.array([x + to_x, y + to_y, radius])
    return np.ascontiguousarray(circles.compress(apart & (radius > 1.0) & (radius < size), axis=1).T)


@lru_cache(maxsize=256)
def _picks(tries: int, points: int) -> Indices:
    """Return the indices of the points that each triple takes, shape ``(3, tries)``."""
    return np.ascontiguousarray((_spread(tries) * points).astype(np.intp).T)


@cache
def _spread(tries: int) -> Points:
    """Return triples of numbers from 0 to 1 that fill the cube evenly, shape ``(tries, 3)``.

    The additive recurrence of M. Roberts (2018); numpy's generators take 10 ms to load.
    """
    return np.outer(np.arange(1, tries + 1), EVENLY) % 1.0


# Pixels are left out only as long as the smallest accepted ball still has this radius in what remains.
MIN_SEARCHED_RADIUS_PX = 1.25

MAX_STEP = 8

# Number of blobs that are looked at: the largest.
MAX_BLOBS = 16


class Blob(Struct, frozen=True, kw_only=True, eq=False):
    """Pixels of the ball's colour that hang together."""

    circle: ImageCircle  # the circle around which its limb may be: as wide or as high as the blob, whichever is more
    contour: cv2.typing.MatLike  # its outline as OpenCV has it, in pixels of the thinned picture
    coloured_px2: float  # area of the pixels in its box that have the colour
    step: int  # every step-th pixel of the picture was looked at
    origin_px: tuple[int, int]  # where the thinned part begins in the picture, x and y

    @property
    def size_px(self) -> float:
        """The larger of its width and its height."""
        return 2 * self.circle.radius_px

    @property
    def fill(self) -> float:
        """The share of the circle around it that has the colour."""
        return self.coloured_px2 / (math.pi * self.circle.radius_px**2)

    @property
    def outline_px(self) -> Points:
        """Points along its outline, shape ``(n, 2)``."""
        return np.asarray(self.contour, np.float64).reshape(-1, 2) * self.step + self.origin_px


def search_step(min_radius_px: float) -> int:
    """Return the k of "every k-th pixel"."""
    return max(1, min(MAX_STEP, int(min_radius_px / MIN_SEARCHED_RADIUS_PX)))


def find_blobs(
    image: Image,
    colour: HsvRange,
    step: int,
    region: Region | None = None,
    *,
    without: Sequence[ImageCircle] = (),
    most: int = MAX_BLOBS,
) -> list[Blob]:
    """Find the largest blobs of a colour, the largest first; looks at every step-th pixel.

    Args:
        without: Balls that are known: what is within them, and a cell around, does not count.
        most: How many at most.
    """
    region = region or Region.whole(image)
    # Nearest-neighbour thinning first, HSV after: at a quarter of 640x480 both take 0.08 ms, HSV of all pixels 0.5 ms
    # (x86).
    mask = colour.mask(thin_out(region.of(image), step))
    for each in without:
        centre = (round((each.x_px - region.left) / step), round((each.y_px - region.top) / step))
        cv2.circle(mask, centre, math.ceil(each.radius_px / step) + 1, 0, cv2.FILLED)
    # Contours, not connected components with statistics, which take 26 times as long on such a mask.
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if len(contours) > most:
        # Of texture, blobs are wide but thin; that of a ball is solid.
        contours = sorted(contours, key=cv2.contourArea, reverse=True)[:most]
    boxed = [(contour, cv2.boundingRect(contour)) for contour in contours]
    boxed.sort(key=lambda pair: (-max(pair[1][2:]), pair[1]))
    return [_make_blob(contour, box, mask, step, (region.left, region.top)) for contour, box in boxed]


def thin_out(image: Image, step: int) -> Image:
    """Return every k-th pixel of every k-th row."""
    if step == 1:
        return image
    height, width = image.shape[:2]
    # OpenCV's nearest neighbour takes the first pixel of each cell, and is four times as fast as slicing and copying.
    whole = image[: height - height % step or height, : width - width % step or width]
    size = (max(1, width // step), max(1, height // step))
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_NEAREST), np.uint8)


def _make_blob(
    contour: cv2.typing.MatLike, box: cv2.typing.Rect, mask: Mask, step: int, origin_px: tuple[int, int]
) -> Blob:
    (x, y, width, height), (left, top) = box, origin_px
    # The pixel that was looked at is the first of its cell; the blob reaches half a cell beyond it on average.
    circle = ImageCircle(
        x_px=left + (x + (width - 1) / 2) * step,
        y_px=top + (y + (height - 1) / 2) * step,
        radius_px=max(width, height) * step / 2,
    )
    coloured = cv2.countNonZero(mask[y : y + height, x : x + width])
    return Blob(circle=circle, contour=contour, coloured_px2=coloured * step**2, step=step, origin_px=origin_px)
