"""Blobs of a range of colours: where in a picture a ball may be.

Most of a picture is not the ball, so only every fourth pixel or so is looked at. Leaving out pixels, not averaging
them, costs a thirteenth of a proper reduction, and each pixel that is left keeps its colour. How large the ball is
comes later, from all pixels along its limb.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.circles import ImageCircle
from stadimeter.detectors.hsv import HsvRange, Mask
from stadimeter.detectors.sampling import Region

# Pixels are left out only as long as the smallest accepted ball still has this radius in what remains.
MIN_SEARCHED_RADIUS_PX = 1.25

MAX_STEP = 8

# Number of blobs that are looked at: the largest.
MAX_BLOBS = 16

# Number of points of an outline, evenly spaced, used where fewer will do.
MAX_POINTS = 60

# Greatest gap between two patches of one ball, and least size of the smaller one, as shares of the larger's size.
PATCH_GAP, MIN_PATCH = 0.5, 0.25


class Blob(Struct, frozen=True, kw_only=True, eq=False):
    """Pixels of the ball's colour that hang together, or several such patches of one ball."""

    circle: ImageCircle  # the circle around which its limb may be: as wide or as high as the blob, whichever is more
    contours: tuple[cv2.typing.MatLike, ...]  # its outlines as OpenCV has them, in pixels of the thinned picture
    mask: Mask  # which pixels in the box of the first of them have the ball's colour
    coloured_px2: float  # area of these
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
    def area_px2(self) -> float:
        """The area within its outlines."""
        return sum(map(cv2.contourArea, self.contours)) * self.step**2

    @property
    def inscribed(self) -> ImageCircle:
        """The largest circle of its pixels: the ball, where other things of its colour touch it."""
        x, y, _, _ = cv2.boundingRect(self.contours[0])
        # The median leaves out single pixels, and what is beyond the box counts as another colour.
        # Distance transform: for each pixel of the blob how far the nearest pixel of another colour is, in cells. Its
        # maximum is the centre and the radius of the largest circle within.
        solid = cv2.copyMakeBorder(cv2.medianBlur(self.mask, 3), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        _, radius, _, (column, row) = cv2.minMaxLoc(cv2.distanceTransform(solid, cv2.DIST_L2, cv2.DIST_MASK_5))
        (left, top), step = self.origin_px, self.step
        return ImageCircle(
            x_px=left + (x + column - 1) * step, y_px=top + (y + row - 1) * step, radius_px=float(radius) * step
        )

    @property
    def outline_px(self) -> Points:
        """Points along its outlines, shape ``(n, 2)``."""
        points = np.concatenate(self.contours) if len(self.contours) > 1 else self.contours[0]
        return np.asarray(points, np.float64).reshape(-1, 2) * self.step + self.origin_px

    @property
    def thinned_px(self) -> Points:
        """No more than `MAX_POINTS` points of its outlines, evenly spaced."""
        outline_px = self.outline_px
        return outline_px[:: max(1, math.ceil(len(outline_px) / MAX_POINTS))]


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


def join_patches(blobs: Sequence[Blob], most: int) -> list[Blob]:
    """Return each of the largest blobs with those near it as one: stripes part a ball into patches."""
    found: list[Blob] = []
    for blob in blobs[:most]:
        patches = [each for each in blobs if _may_be_one(blob, each)]
        if len(patches) > 1 and not any(blob.contours[0] is known for one in found for known in one.contours):
            found.append(_join(patches))
    return found


def _may_be_one(blob: Blob, other: Blob) -> bool:
    """Return whether a blob and one that is no larger may be patches of the same ball."""
    one, two = blob.circle, other.circle
    # Gap between two circles along the line of their centres, below zero where they overlap.
    gap_px = math.hypot(one.x_px - two.x_px, one.y_px - two.y_px) - one.radius_px - two.radius_px
    return gap_px < PATCH_GAP * one.radius_px and MIN_PATCH * one.radius_px <= two.radius_px <= one.radius_px


def _join(patches: Sequence[Blob]) -> Blob:
    # The box around all patches: its longer side is the diameter, since a stripe parts a ball across but seldom both
    # ways.
    circles = [patch.circle for patch in patches]
    left, right = (min(c.x_px - c.radius_px for c in circles), max(c.x_px + c.radius_px for c in circles))
    top, bottom = (min(c.y_px - c.radius_px for c in circles), max(c.y_px + c.radius_px for c in circles))
    return Blob(
        circle=ImageCircle(
            x_px=(left + right) / 2, y_px=(top + bottom) / 2, radius_px=max(right - left, bottom - top) / 2
        ),
        contours=tuple(contour for patch in patches for contour in patch.contours),
        mask=patches[0].mask,
        coloured_px2=sum(patch.coloured_px2 for patch in patches),
        step=patches[0].step,
        origin_px=patches[0].origin_px,
    )


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
    part = mask[y : y + height, x : x + width]
    return Blob(
        circle=circle,
        contours=(contour,),
        mask=part,
        coloured_px2=cv2.countNonZero(part) * step**2,
        step=step,
        origin_px=origin_px,
    )
