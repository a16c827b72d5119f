"""Sheets as hands make them, cut with scissors; strips of tape; several at once."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Protocol

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.simulation.camera import Vector
from support.scenes.plane import PAPER_BGR, Pose, Posed
from support.scenes.target import Colour, Floats, Layer, Rays, Target, slope
from support.scenes.tone import decode_srgb

Plane = NDArray[np.float32]

STEPS = 128
"""A side's deviation is kept at so many steps along it."""

WAVES = ((0.8, 0.6), (4.0, 0.28), (11.0, 0.12))
"""Frequency along half a side, in rad, and share of the variance. The first is nearly an offset and an angle."""


class HandCut(Struct, frozen=True, kw_only=True):
    """By how much the sides of a sheet are off the rectangle that was meant.

    Each place of a side lies evenly spread between minus and plus the most, so with a root mean square of the most
    over √3, and smoothly along the side: too long or too short, at an angle, and wavy.

    Attributes:
        ends_m: The most for the two sides that its own x axis crosses.
        sides_m: The most for the other two.
        seed: The deviations follow from it.
    """

    ends_m: float
    sides_m: float
    seed: int

    def deviation_m(self, side: int, place: Floats) -> Floats:
        """Return by how much a side lies too far out.

        Args:
            side: 0 right, 1 bottom, 2 left, 3 top.
            place: Where along it, from -1 to 1.

        Returns:
            Of the same shape as ``place``.
        """
        most = self.sides_m if side % 2 else self.ends_m
        along = np.linspace(-1, 1, STEPS + 1)
        return np.asarray(most * np.interp(place, along, _deviations(self.seed, side)))


class CutSheetTarget(Posed, Struct, frozen=True, kw_only=True):
    """A sheet or a strip of tape. What is measured is the rectangle that was meant.

    Attributes:
        pose: Where it is.
        width_m: The side along its own x axis that was meant.
        height_m: The other one.
        cut: How its sides deviate; None for a perfect rectangle.
        bgr: Its colour.
        sheen: Standard deviation of how evenly it sends light back, as a share: tape is blotchy.
        seed: Its blotches follow from this.
    """

    pose: Pose
    width_m: float
    height_m: float
    cut: HandCut | None = None
    bgr: Colour = PAPER_BGR
    sheen: float = 0.0
    seed: int = 0

    def outline_m(self) -> Points:
        """Return the corners of the rectangle that was meant, in order around it."""
        half = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * self._half
        return self.pose.placed(half)

    def cut_outline_m(self) -> Points:
        """Return places all along its true sides, in order around it."""
        place = np.linspace(-1, 1, STEPS + 1)
        (w, h), off = self._half, self._deviation_m
        top = np.column_stack((w * place, -h - off(3, place)))
        right = np.column_stack((w + off(0, place), h * place))
        bottom = np.column_stack((w * place, h + off(1, place)))[::-1]
        left = np.column_stack((-w - off(2, place), h * place))[::-1]
        return self.pose.placed(np.vstack((top, right, bottom, left)))

    def extent_m(self) -> Points:
        """Return its true sides."""
        return self.cut_outline_m()

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how long its longer side appears if it is not tilted."""
        return camera.fx_px * max(self.width_m, self.height_m) / self.position_m[2]

    def layer(self, rays: Rays) -> Layer:
        """Return what it covers, and its light."""
        x, y, front = self.pose.hit(rays)
        return Layer(self._cover(x, y) * front, self._colours(x, y))

    @property
    def _half(self) -> tuple[float, float]:
        return self.width_m / 2, self.height_m / 2

    def _deviation_m(self, side: int, place: Floats) -> Floats:
        return np.zeros(place.shape) if self.cut is None else self.cut.deviation_m(side, place)

    def _cover(self, x: Floats, y: Floats) -> Plane:
        """Return how much of each sample is paper: the product of what each side leaves."""
        (w, h), off = self._half, self._deviation_m
        steep_x, steep_y = slope(x), slope(y)
        right = np.clip((w + off(0, y / h) - x) / steep_x + 0.5, 0, 1)
        left = np.clip((w + off(2, y / h) + x) / steep_x + 0.5, 0, 1)
        bottom = np.clip((h + off(1, x / w) - y) / steep_y + 0.5, 0, 1)
        top = np.clip((h + off(3, x / w) + y) / steep_y + 0.5, 0, 1)
        return (right * left * bottom * top).astype(np.float32)

    def _colours(self, x: Floats, y: Floats) -> Plane:
        paper = np.broadcast_to(decode_srgb(self.bgr), (*x.shape, 3))
        if self.sheen == 0:
            return paper
        blotches = _looked_up(_blotches(self.seed), x / self.width_m + 0.5, y / self.height_m + 0.5)
        return np.asarray(np.clip(paper * (1 + np.float32(self.sheen) * blotches)[:, :, None], 0, None), np.float32)


class FlatTarget(Target, Protocol):
    """A target that lies in a plane."""

    @property
    def pose(self) -> Pose:
        """Where it is."""
        ...


class GroupTarget(Struct, frozen=True, kw_only=True):
    """A target with others beside it. Its truth is that of the first.

    Attributes:
        first: What is measured.
        others: What else is drawn, behind it.
    """

    first: FlatTarget
    others: tuple[FlatTarget, ...]

    @property
    def position_m(self) -> Vector:
        """The centre of the first."""
        return self.first.position_m

    @property
    def tilt_rad(self) -> float:
        """The tilt of the first."""
        return self.first.tilt_rad

    def outline_m(self) -> Points:
        """Return the corners of the first."""
        return self.first.outline_m()

    def extent_m(self) -> Points:
        """Return points around all of them."""
        return np.vstack([each.extent_m() for each in (self.first, *self.others)])

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how large the first appears."""
        return self.first.apparent_px(camera)

    def layer(self, rays: Rays) -> Layer:
        """Return what all of them cover, the first on top."""
        merged = self.first.layer(rays)
        for other in self.others:
            behind = other.layer(rays)
            left = (1 - merged.cover) * behind.cover
            cover = merged.cover + left
            light = merged.light * merged.cover[:, :, None] + behind.light * left[:, :, None]
            merged = Layer(cover, np.asarray(light / np.maximum(cover, 1e-6)[:, :, None], np.float32))
        return merged


@lru_cache(maxsize=64)
def _deviations(seed: int, side: int) -> Floats:
    """Return a side's deviations along it, from -1 to 1 of the most.

    A sum of waves that is normally distributed at each place goes through the normal distribution: what comes out is
    evenly spread.
    """
    rng, along = np.random.default_rng((seed, 80, side)), np.linspace(-1, 1, STEPS + 1)
    normal = np.zeros(STEPS + 1)
    for frequency, share in WAVES:
        first, second = rng.standard_normal(2) * math.sqrt(share)
        normal += first * np.cos(frequency * along) + second * np.sin(frequency * along)
    return np.array([math.erf(value / math.sqrt(2)) for value in normal])


@lru_cache(maxsize=4)
def _blotches(seed: int) -> Plane:
    coarse = np.random.default_rng((seed, 82)).standard_normal((12, 12), dtype=np.float32)
    return np.asarray(cv2.resize(coarse, (256, 256), interpolation=cv2.INTER_CUBIC), np.float32)


def _looked_up(page: Plane, across: Floats, down: Floats) -> Plane:
    """Return the values of a page at places from 0 to 1."""
    x, y = (np.asarray(part * 256 - 0.5, np.float32) for part in (across, down))
    return np.asarray(cv2.remap(page, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
