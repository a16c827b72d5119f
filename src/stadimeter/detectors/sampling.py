"""Reading a picture: a part of it, what its border cuts off, as light, and at a smaller size.

A pixel on an edge sees some of the one side and some of the other, and what it collects is light. A picture file does
not hold light: a camera writes each value through a tone curve, so that half the light between black and white becomes
188 of 255, not 128. Half way up in code values is therefore not where the edge is: on a sharp picture it lies about a
third of a pixel inside the brighter side. Measured in light it is.

Written out with numpy where OpenCV's own functions round differently from one version to the next.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TypeVar

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import ToneCurve
from stadimeter.core.detection import Flags, Plane, Points, Prediction
from stadimeter.core.frame import Image

# How far a target may be from where it is expected, in standard deviations.
REGION_SIGMAS = 4.0


class Region(Struct, frozen=True, kw_only=True):
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

    @classmethod
    def expected(
        cls,
        prediction: Prediction | None,
        image: Image,
        *,
        sizes: float,
        margin_px: float = 0.0,
        outwards: bool = False,
    ) -> Region | None:
        """Return where a target is expected: that many of its sizes, and four standard deviations, to each side."""
        if prediction is None:
            return None
        half_px = sizes * prediction.size_px + REGION_SIGMAS * prediction.sigma_px + margin_px
        return cls.around(prediction.centre_px, half_px, image, outwards=outwards)

    @property
    def left_top_px(self) -> Points:
        """Its first pixel, x and y."""
        return np.array((self.left, self.top), np.float64)

    def of(self, image: Image) -> Image:
        """Return this part of a picture, not copied."""
        return image[self.top : self.bottom, self.left : self.right]


def touches_border(points_px: Points, shape: tuple[int, ...], margin_px: float) -> bool:
    """Check whether an outline, ``(n, 2)``, comes nearer than a margin to the outermost pixels, or passes them."""
    return bool(corners_on_border(points_px[None], shape, margin_px)[0])


def sides_on_border(corners_px: Points, shape: tuple[int, ...], margin_px: float) -> Flags:
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


def corners_on_border(corners_px: Points, shape: tuple[int, ...], margin_px: float) -> Flags:
    """Return which outlines, shape ``(c, n, 2)``, reach the border of the picture or pass it, shape ``(c,)``."""
    last_px = np.array((shape[1], shape[0])) - 1 - margin_px
    return np.asarray(((corners_px < margin_px) | (corners_px > last_px)).any(axis=(1, 2)))


def grey_of(image: Image) -> Image:
    """Return a picture in code values of grey, shape ``(height, width)``."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def reduced(image: Image, long_side_px: int, interpolation: int = cv2.INTER_AREA) -> tuple[Image, float]:
    """Return a picture with its long side no longer than that, and its scale: 0.5 for half the size.

    Each pixel is the mean of those that it replaces. With ``cv2.INTER_LINEAR`` it is that at half the size, and at
    other sizes the mean of four pixels near its centre, which takes less time.
    """
    height, width = image.shape[:2]
    scale = min(1.0, long_side_px / max(width, height))
    if scale == 1.0:
        return image, scale
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), np.uint8), scale


def to_full_scale(points_px: Points, scale: float) -> Points:
    """Return where points of a reduced picture are in the full one; (0, 0) is the centre of the first pixel."""
    return (points_px + 0.5) / scale - 0.5


Light = NDArray[np.float32]
Real = TypeVar("Real", np.float32, np.float64)

CODES = 256


@cache
def light_table(tone_curve: ToneCurve) -> Light:
    """Return the light that each code value of 8 bits stands for; ``light_table("srgb")[image]`` decodes a picture.

    It rises from 0 for black to 1 for the brightest value, shape ``(256,)``, read-only. ``srgb`` is what phones and
    cameras write by default (IEC 61966-2-1), ``linear`` for a camera whose values are in proportion to the light.
    """
    # IEC 61966-2-1: a straight part below 0.04045 of full scale, and a power of 2.4 above it.
    share = np.arange(CODES, dtype=np.float64) / (CODES - 1)
    if tone_curve == "srgb":
        share = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    table = share.astype(np.float32)
    table.setflags(write=False)
    return table


def in_light(codes: Plane, light: Light) -> Light:
    """Return the light of code values of any shape; quicker than indexing with them."""
    return np.asarray(cv2.LUT(codes.reshape(len(codes), -1), light), np.float32).reshape(codes.shape)


def median(rows: NDArray[Real]) -> NDArray[Real]:
    """Return the (upper) median along the last axis, which stays with length 1; much faster than numpy's for few."""
    half = rows.shape[-1] // 2
    ordered = rows.copy()
    ordered.partition(half, axis=-1)
    return ordered[..., half : half + 1]


def quantile(values: NDArray[Real], share: float = 0.5) -> float:
    """Return the value that this share of the values is below, by default the (upper) median; faster than numpy's."""
    ordered = values.copy()
    ordered.sort()
    return float(ordered[int(share * len(ordered))])
