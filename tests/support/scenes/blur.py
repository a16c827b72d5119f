"""What blurs a picture before it reaches the sensor: the lens' point spread and motion during the exposure.

Both act on light, so they work on linear light, and on the samples before these are averaged to pixels.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Plane = NDArray[np.float32]

REACH_SIGMAS = 4.0
"""The point spread is cut off there; 0.006 % of a Gaussian's light lies further out."""


class Blur(Struct, frozen=True, kw_only=True):
    """What a point of light becomes.

    Attributes:
        sigma_px: Standard deviation of the lens' point spread, a Gaussian, without the pixel's own square.
        motion_px: How far the picture moves during the exposure, evenly.
        direction_rad: Which way, from right towards down.
    """

    sigma_px: float = 0.7
    motion_px: float = 0.0
    direction_rad: float = 0.0

    def __post_init__(self) -> None:
        if not (0 <= self.sigma_px < 50 and 0 <= self.motion_px < 200):
            raise ValueError(
                f"a blur of {self.sigma_px} px and {self.motion_px} px of motion is too much or too little to draw"
            )

    @property
    def reach_px(self) -> int:
        """How far light spreads, rounded up to whole pixels."""
        return math.ceil(REACH_SIGMAS * self.sigma_px + self.motion_px / 2) + 1

    def of_samples(self, samples: Plane, finer: int) -> Plane:
        """Blur samples, ``finer`` of which make a pixel."""
        if self.sigma_px > 0:
            spread = _gaussian(self.sigma_px * finer)
            samples = _plane(cv2.sepFilter2D(samples, -1, spread, spread, borderType=cv2.BORDER_REPLICATE))
        if self.motion_px > 0:
            line = _line(self.motion_px * finer, self.direction_rad)
            samples = _plane(cv2.filter2D(samples, -1, line, borderType=cv2.BORDER_REPLICATE))
        return samples

    def of_pixels(self, picture: Plane, finer: int) -> Plane:
        """Blur whole pixels as if each were ``finer`` × ``finer`` equal samples, so that a patch of samples fits in.

        Its kernel is what becomes of a single pixel in `of_samples`.
        """
        if self.sigma_px == 0 and self.motion_px == 0:
            return picture
        reach = self.reach_px + 1
        single = np.zeros(((2 * reach + 1) * finer,) * 2, np.float32)
        single[reach * finer : (reach + 1) * finer, reach * finer : (reach + 1) * finer] = 1
        spread = self.of_samples(single, finer)
        kernel = cv2.resize(spread, (2 * reach + 1,) * 2, interpolation=cv2.INTER_AREA)
        return _plane(cv2.filter2D(picture, -1, kernel, borderType=cv2.BORDER_REPLICATE))


def _gaussian(sigma: float) -> Plane:
    reach = math.ceil(REACH_SIGMAS * sigma)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return _plane(weights / weights.sum())


def _line(length: float, direction_rad: float) -> Plane:
    """Return a kernel that smears along a line: many points on it, each shared among the four samples around it."""
    reach = math.ceil(length / 2) + 1
    along = (np.arange(math.ceil(length * 8)) + 0.5) / math.ceil(length * 8) * length - length / 2
    x, y = along * math.cos(direction_rad) + reach, along * math.sin(direction_rad) + reach
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = np.abs(1 - right - (x - left)) * np.abs(1 - down - (y - top))
        np.add.at(kernel, (top + down, left + right), weight)
    return _plane(kernel / kernel.sum())


def _plane(array: object) -> Plane:
    return np.asarray(array, np.float32)
