"""What is behind a target: a plain wall, or clutter."""

from __future__ import annotations

import math
from typing import Protocol

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from support.scenes.target import Colour
from support.scenes.tone import decode_srgb

Plane = NDArray[np.float32]

FINER = 2
"""Clutter is drawn at twice the resolution with smooth edges, and averaged in linear light."""

FRACTION_BITS = 4
SHEETLIKE_ASPECTS = (1.22, 1.62)
"""No rectangle of the clutter has an aspect between these: one of letter or A4 would be a sheet, to any detector."""

ROUNDEST = 0.8
"""No ellipse of the clutter is rounder than this: a disc of the ball's colour would be a ball, to any detector."""

TARGET_HUES = (25, 70)
TARGET_SATURATION = 60
"""Hue, of 180, and least saturation, of 255, of what may be taken for the colour of a tennis ball."""

MOST_ELONGATED = 4.0
CALM_RADII = 1.35
"""Distractors keep this far from the target, in radii of it: touching ones would be another trouble."""


class KeepOut(Struct, frozen=True, kw_only=True):
    """A circle in the picture.

    Attributes:
        centre_px: Its centre.
        radius_px: Its radius.
    """

    centre_px: tuple[float, float]
    radius_px: float


class Backdrop(Protocol):
    """What is behind a target. Equal ones hash equally."""

    def __hash__(self) -> int: ...

    @property
    def avoids_target(self) -> bool:
        """Whether it depends on where the target is."""
        ...

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> Plane:
        """Return its linear light.

        Args:
            width_px: Width of the picture.
            height_px: Height of the picture.
            seed: Everything random follows from it.
            keep_out: Where the target is; None for an empty scene.

        Returns:
            Shape ``(height, width, 3)``, blue first, new.
        """
        ...


class PlainBackdrop(Struct, frozen=True, kw_only=True):
    """A wall with faint stains.

    Attributes:
        bgr: Its colour.
        stains: Their standard deviation as a share of the wall's brightness.
    """

    bgr: Colour = (88, 96, 104)
    stains: float = 0.04

    @property
    def avoids_target(self) -> bool:
        """It does not."""
        return False

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> Plane:
        """Return its linear light; it is the same with and without a target."""
        rng = np.random.default_rng((seed, 2))
        brightness = np.clip(1 + _stains(width_px, height_px, rng) * np.float32(self.stains), 0, None)
        return np.asarray(brightness[:, :, None] * decode_srgb(self.bgr), np.float32)


class ClutterBackdrop(Struct, frozen=True, kw_only=True):
    """Shapes of all colours on top of each other: rectangles, some of them in perspective, ellipses, polygons, bars.

    Attributes:
        shapes: How many.
        like_target: The share of the shapes of a tennis ball's colour that keep it; the others get another one. By
            default, one picture in ten has such a shape; 1 leaves five or so in every picture.
        grain: Standard deviation of the fine texture on them, as a share of their brightness.
        distractors: How many shapes of the target's colour lie on top of the rest, none of them round, each away from
            the target.
        distractor_bgr: Their colour.
    """

    shapes: int = 60
    like_target: float = 0.015
    grain: float = 0.05
    distractors: int = 0
    distractor_bgr: Colour = (52, 232, 190)

    @property
    def avoids_target(self) -> bool:
        """Whether there are distractors, which keep away from it."""
        return self.distractors > 0

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> Plane:
        """Return its linear light."""
        rng = np.random.default_rng((seed, 3))
        size = np.array((width_px, height_px))
        ground = np.full((height_px * FINER, width_px * FINER, 3), self._colour(rng), np.uint8)
        for _ in range(self.shapes):
            reach = float(np.exp(rng.uniform(math.log(0.02), math.log(0.28)))) * width_px
            _draw(ground, _shape(rng, rng.uniform(0, 1, 2) * size, reach), self._colour(rng))
        texture = 1 + np.float32(self.grain) * rng.standard_normal((height_px, width_px), dtype=np.float32)
        shade = (1 + np.float32(0.12) * _stains(width_px, height_px, rng)) * texture
        self._distract(ground, size, keep_out, np.random.default_rng((seed, 4)))
        mean = cv2.resize(_decoded(ground), (width_px, height_px), interpolation=cv2.INTER_AREA)
        return np.asarray(np.clip(mean * shade[:, :, None], 0, None), np.float32)

    def _colour(self, rng: np.random.Generator) -> Colour:
        """Return a colour: a third of the things are grey, black or white, as in rooms."""
        is_grey, keeps_colour, grey = rng.random() < 0.35, rng.random() < self.like_target, int(rng.integers(10, 246))
        near_grey, any_colour = np.clip(grey + rng.integers(-8, 9, 3), 0, 255), rng.integers(5, 250, 3)
        blue, green, red = (int(part) for part in (near_grey if is_grey else any_colour))
        # With blue and green exchanged, what was yellow or green is pink or blue.
        return (green, blue, red) if not keeps_colour and _is_like_target((blue, green, red)) else (blue, green, red)

    def _distract(
        self, ground: NDArray[np.uint8], size: NDArray[np.int_], keep_out: KeepOut | None, rng: np.random.Generator
    ) -> None:
        for _ in range(self.distractors):
            reach = float(rng.uniform(0.012, 0.05)) * size[0]
            place = _clear_place(rng, size, reach, keep_out)
            if place is not None:
                _draw(ground, _angular(rng, place, reach), self.distractor_bgr)


def _clear_place(
    rng: np.random.Generator, size: NDArray[np.int_], reach: float, keep_out: KeepOut | None
) -> NDArray[np.float64] | None:
    """Return a place for a shape away from the target; None if there is hardly any room."""
    for _ in range(50):
        place = np.asarray(rng.uniform(0, 1, 2) * size)
        if keep_out is None:
            return place
        if math.dist(place, keep_out.centre_px) > CALM_RADII * keep_out.radius_px + reach:
            return place
    return None


def _shape(rng: np.random.Generator, centre: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Return a random shape as a polygon."""
    kind = rng.random()
    if kind < 0.35:
        return _rectangle(rng, centre, reach, perspective=0.0)
    if kind < 0.55:
        return _rectangle(rng, centre, reach, perspective=rng.uniform(0.02, 0.25))
    if kind < 0.75:
        angles = np.linspace(0, 2 * math.pi, 64, endpoint=False)
        axes = reach * np.array((1.0, rng.uniform(0.3, ROUNDEST)))
        return _turned(np.column_stack((np.cos(angles), np.sin(angles))) * axes, rng) + centre
    if kind < 0.9:
        return _angular(rng, centre, reach)
    return _turned(_box(1.0, 0.04) * (reach * 3), rng) + centre


def _rectangle(
    rng: np.random.Generator, centre: NDArray[np.float64], reach: float, perspective: float
) -> NDArray[np.float64]:
    low, high = SHEETLIKE_ASPECTS
    aspect = rng.uniform(1.0, low) if rng.random() < 0.35 else rng.uniform(high, MOST_ELONGATED)
    corners = _turned(_box(1.0, 1 / aspect) * reach, rng)
    farther = 1 + perspective * corners[:, :1] / reach
    return np.asarray(corners / farther + centre)


def _angular(rng: np.random.Generator, centre: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Return a triangle to heptagon with corners at uneven distances."""
    count = int(rng.integers(3, 8))
    angles = np.sort(rng.uniform(0, 2 * math.pi, count))
    out = rng.uniform(0.35, 1.0, count)[:, None] * reach
    return np.asarray(np.column_stack((np.cos(angles), np.sin(angles))) * out + centre)


def _box(half_width: float, half_height: float) -> NDArray[np.float64]:
    return np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * (half_width, half_height)


def _turned(points: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    angle = rng.uniform(0, math.pi)
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.asarray(points @ np.array(((cosine, sine), (-sine, cosine))))


def _is_like_target(bgr: Colour) -> bool:
    hue, saturation, _ = cv2.cvtColor(np.array([[bgr]], np.uint8), cv2.COLOR_BGR2HSV)[0, 0]
    return bool(TARGET_HUES[0] <= hue <= TARGET_HUES[1] and saturation >= TARGET_SATURATION)


def _draw(ground: NDArray[np.uint8], polygon: NDArray[np.float64], bgr: Colour) -> None:
    fixed = np.rint(((polygon + 0.5) * FINER - 0.5) * (1 << FRACTION_BITS)).astype(np.int32)
    cv2.fillPoly(ground, [fixed.reshape(-1, 1, 2)], bgr, lineType=cv2.LINE_AA, shift=FRACTION_BITS)


def _decoded(ground: NDArray[np.uint8]) -> Plane:
    return np.asarray(decode_srgb(np.arange(256))[ground], np.float32)


def _stains(width_px: int, height_px: int, rng: np.random.Generator) -> Plane:
    """Return broad differences in brightness with a standard deviation of about 1."""
    coarse = rng.standard_normal((max(3, height_px // 60), max(3, width_px // 60)), dtype=np.float32)
    return np.asarray(cv2.resize(coarse, (width_px, height_px), interpolation=cv2.INTER_CUBIC), np.float32)
