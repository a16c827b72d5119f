"""Reading a picture: as light, between its pixels, and at a smaller size.

A pixel on an edge sees some of the one side and some of the other, and what it collects is light. A picture file does
not hold light: a camera writes each value through a tone curve, so that half the light between black and white becomes
188 of 255, not 128. Half way up in code values is therefore not where the edge is: on a sharp picture it lies about a
third of a pixel inside the brighter side. Measured in light it is.

Written out with numpy where OpenCV's own functions round differently from one version to the next.
"""

from __future__ import annotations

from functools import cache
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import ToneCurve
from stadimeter.core.detection import Points
from stadimeter.core.frame import Image

Samples = NDArray[np.float32]


def sample(image: Image, x_px: Points, y_px: Points) -> Samples:
    """Read a picture between its pixels, bilinearly, for coordinates of any shape; channels are added to it.

    Outside, the outermost pixels go on for ever.
    """
    height, width = image.shape[:2]
    x = np.clip(x_px, 0, width - 1)
    y = np.clip(y_px, 0, height - 1)
    # The pixel above left of each place, or the last but one, so that there is always one to its right and below.
    left = np.minimum(x.astype(np.intp), width - 2) if width > 1 else np.zeros(x.shape, np.intp)
    top = np.minimum(y.astype(np.intp), height - 2) if height > 1 else np.zeros(y.shape, np.intp)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    share_x = (x - left).astype(np.float32)[..., np.newaxis]
    share_y = (y - top).astype(np.float32)[..., np.newaxis]
    above = image[top, left] * (1 - share_x) + image[top, right] * share_x
    below = image[bottom, left] * (1 - share_x) + image[bottom, right] * share_x
    values: Samples = above * (1 - share_y) + below * share_y
    return values


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


def in_light(codes: NDArray[np.uint8], light: Light) -> Samples:
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
