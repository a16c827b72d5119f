"""A part of a picture that is worked on at a finer scale."""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.detection import Points

Plane = NDArray[np.float32]


class Patch(Struct, frozen=True, kw_only=True):
    """A part of a picture in whole pixels, right and bottom excluded, each of them ``finer`` × ``finer`` samples.

    Attributes:
        left: First column.
        top: First row.
        right: The column after the last.
        bottom: The row after the last.
        finer: How many samples there are along a pixel.
    """

    left: int
    top: int
    right: int
    bottom: int
    finer: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.right - self.left, self.bottom - self.top

    @property
    def rows_and_columns(self) -> tuple[slice, slice]:
        """What cuts it out of a picture."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def samples_of(self, picture: Plane) -> Plane:
        """Cut the patch out of a picture and repeat each pixel in its samples."""
        part = picture[self.rows_and_columns]
        return np.repeat(np.repeat(part, self.finer, axis=0), self.finer, axis=1)

    def averaged(self, samples: Plane) -> Plane:
        """Return the mean of each pixel's samples."""
        return np.asarray(cv2.resize(samples, self.size, interpolation=cv2.INTER_AREA), np.float32)

    def shrunk(self, margin_px: int, width_px: int, height_px: int) -> Patch:
        """Return the patch without a margin, which stays along the borders of the picture."""
        return Patch(
            left=self.left + (margin_px if self.left > 0 else 0),
            top=self.top + (margin_px if self.top > 0 else 0),
            right=self.right - (margin_px if self.right < width_px else 0),
            bottom=self.bottom - (margin_px if self.bottom < height_px else 0),
            finer=self.finer,
        )


def patch_around(points_px: Points, margin_px: int, size_px: tuple[int, int], finer: int) -> Patch | None:
    """Return the part of a picture around some points.

    Args:
        points_px: Shape ``(n, 2)``.
        margin_px: How much is added on each side.
        size_px: Width and height of the picture.
        finer: How many samples there are along a pixel.

    Returns:
        The part; None if it lies outside the picture.
    """
    (left, top), (right, bottom) = points_px.min(axis=0), points_px.max(axis=0)
    patch = Patch(
        left=max(0, math.floor(left) - margin_px),
        top=max(0, math.floor(top) - margin_px),
        right=min(size_px[0], math.ceil(right) + 1 + margin_px),
        bottom=min(size_px[1], math.ceil(bottom) + 1 + margin_px),
        finer=finer,
    )
    return patch if patch.left < patch.right and patch.top < patch.bottom else None
