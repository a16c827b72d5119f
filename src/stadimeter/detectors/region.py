"""A part of a picture, and what the border of the picture cuts off."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A part of a picture in whole pixels; right and bottom are the first beyond it."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def whole(cls, image: Image) -> Region:
        """Return all of a picture."""
        return cls(left=0, top=0, right=image.shape[1], bottom=image.shape[0])

    @classmethod
    def around(
        cls, centre_px: tuple[float, float], half_px: float, image: Image, *, outwards: bool = False
    ) -> Region | None:
        """Return the square around a point, as far as it is inside the picture.

        The first row and column are rounded outwards, the last ones where `outwards` asks for it. None outside of the
        picture or where a number is not finite: a prediction may be anything.
        """
        if not all(map(math.isfinite, (*centre_px, half_px))):
            return None
        (x, y), (height, width) = centre_px, image.shape[:2]
        last = math.ceil if outwards else math.floor
        left, right = max(math.floor(x - half_px), 0), min(last(x + half_px) + 1, width)
        top, bottom = max(math.floor(y - half_px), 0), min(last(y + half_px) + 1, height)
        if right <= left or bottom <= top:
            return None
        return cls(left=left, top=top, right=right, bottom=bottom)

    @property
    def left_top_px(self) -> Points:
        """Its first pixel, x and y."""
        return np.array((self.left, self.top), np.float64)

    def of(self, image: Image) -> Image:
        """Return this part of a picture, not copied."""
        return image[self.top : self.bottom, self.left : self.right]


def touches_border(points_px: Points, width_px: int, height_px: int, margin_px: float) -> bool:
    """Return whether an outline, ``(n, 2)``, comes nearer than a margin to the outermost pixels, or passes them."""
    left, top = points_px.min(axis=0).tolist()
    right, bottom = points_px.max(axis=0).tolist()
    return bool(
        left < margin_px or top < margin_px or right > width_px - 1 - margin_px or bottom > height_px - 1 - margin_px
    )


def sides_on_border(corners_px: Points, shape: tuple[int, ...], margin_px: float) -> NDArray[np.bool_]:
    """Return which sides of outlines have both ends at one border of the picture, shape ``(c, n)``.

    Args:
        corners_px: Corners in order around each, shape ``(c, n, 2)``; side i leads from corner i to corner i + 1.
        shape: Height and width of the picture.
        margin_px: How near to the outermost pixels counts as on the border.
    """
    # For x and y each: left or top, right or bottom. A side lies on a border if both its ends are beyond the same one.
    last_px = np.array((shape[1], shape[0])) - 1 - margin_px
    low, high = corners_px < margin_px, corners_px > last_px
    after = [*range(1, corners_px.shape[1]), 0]
    return np.asarray(((low & low[:, after]) | (high & high[:, after])).any(axis=2))


def corners_on_border(corners_px: Points, shape: tuple[int, ...], margin_px: float) -> NDArray[np.bool_]:
    """Return which outlines, shape ``(c, n, 2)``, reach the border of the picture or pass it, shape ``(c,)``."""
    last_px = np.array((shape[1], shape[0])) - 1 - margin_px
    return np.asarray(((corners_px < margin_px) | (corners_px > last_px)).any(axis=(1, 2)))
