"""What is behind a target: plain walls, clutter, floors, and shadows on all of them."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Protocol

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from support.scenes.target import Colour
from support.scenes.tone import decode_srgb

# What is behind a target: a plain wall, or clutter.

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


# Floors that a ball lies on: carpet, wood, concrete and grass, with the ball's shadow; and walls as bright as it.

TEXTURE_PX = 1024


class Ground(StrEnum):
    """What a floor is made of."""

    CARPET = "carpet"
    WOOD = "wood"
    CONCRETE = "concrete"
    GRASS = "grass"
    MAT = "plain mat"


class FloorBackdrop(Struct, frozen=True, kw_only=True):
    """A floor seen at a slant, that gets smaller towards the top of the picture.

    Attributes:
        ground: Its kind.
        bgr: Its mean colour.
        contrast: How strongly its texture varies, as a share of its light.
        grain_px: Size of its finest grains at the bottom of the picture.
        slant: By how much smaller it is at the top than at the bottom, from 0 (seen from above) to below 1.
        shadow: How much light the contact shadow takes, from 0 to 1.
        shadow_rad: Where the shadow falls, from right towards down.
    """

    ground: Ground
    bgr: Colour
    contrast: float = 0.25
    grain_px: float = 2.0
    slant: float = 0.5
    shadow: float = 0.6
    shadow_rad: float = math.pi / 2

    @property
    def avoids_target(self) -> bool:
        """The shadow lies where the ball is."""
        return True

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> Plane:
        """Return its linear light, with the shadow of a ball at the circle to keep out of."""
        rng = np.random.default_rng((seed, 60))
        texture = np.maximum(1 + np.float32(self.contrast) * _texture(self.ground, self.grain_px, rng), 0.03)
        seen = _slanted(texture, width_px, height_px, self.slant) * decode_srgb(self.bgr)
        across = np.linspace(-1, 1, width_px)[None, :] * rng.uniform(-0.25, 0.25)
        down = np.linspace(-1, 1, height_px)[:, None] * rng.uniform(-0.25, 0.25)
        seen = seen * (1 + across + down).astype(np.float32)[:, :, None]
        if keep_out is not None and self.shadow > 0:
            seen = seen * self._unshaded(width_px, height_px, keep_out, rng)[:, :, None]
        return np.asarray(seen, np.float32)

    def _unshaded(self, width_px: int, height_px: int, ball: KeepOut, rng: np.random.Generator) -> Plane:
        """Return the share of light that is left: a narrow dark foot below the ball, and a wide soft shadow beside."""
        y, x = np.mgrid[:height_px, :width_px].astype(np.float32)
        (x0, y0), r = ball.centre_px, ball.radius_px
        foot = np.exp(-(((x - x0) / (0.75 * r)) ** 2 + ((y - y0 - 0.85 * r) / (0.3 * r)) ** 2))
        ahead, aside = math.cos(self.shadow_rad), math.sin(self.shadow_rad)
        length = float(rng.uniform(0.4, 1.0)) * r
        u = (x - x0 - ahead * length) * ahead + (y - y0 - 0.5 * r - aside * 0.4 * length) * aside
        v = -(x - x0 - ahead * length) * aside + (y - y0 - 0.5 * r - aside * 0.4 * length) * ahead
        inside = 1 - np.hypot(u / (1.1 * r), v / (0.75 * r))
        cast = np.clip(inside / 0.25 + 0.5, 0, 1)
        left = (1 - self.shadow * foot) * (1 - 0.6 * self.shadow * cast)
        return np.asarray(np.clip(left, 0.04, 1), np.float32)


def _texture(ground: Ground, grain_px: float, rng: np.random.Generator) -> Plane:
    """Return the variation of a floor's light about its mean, about one standard deviation of 1, for each channel."""
    if ground is Ground.CARPET:
        speckle = 0.8 * _noise(rng, grain_px) + 0.5 * _noise(rng, 2.5 * grain_px)
        coloured = np.stack([_noise(rng, grain_px) for _ in range(3)], axis=2)
        return np.asarray(speckle[:, :, None] + 0.35 * coloured, np.float32)
    if ground is Ground.WOOD:
        grain = _noise(rng, grain_px, 40 * grain_px) + 0.6 * _noise(rng, 4 * grain_px, 90 * grain_px)
        planks = np.repeat(rng.standard_normal(TEXTURE_PX // 64 + 1), 64)[:TEXTURE_PX]
        gaps = np.where(np.arange(TEXTURE_PX) % 64 < 1.5, -2.5, 0.0)
        one = 0.6 * grain + 0.5 * planks[:, None] + gaps[:, None]
        return np.asarray(np.stack([1.15 * one, one, 0.85 * one], axis=2), np.float32)
    if ground is Ground.GRASS:
        blades = sum(_leaning(_noise(rng, grain_px, 9 * grain_px), lean) for lean in rng.uniform(-60, 60, 3))
        warm = _noise(rng, 12 * grain_px)
        return np.asarray(np.stack([blades * 0.9, blades + 0.1 * warm, blades + 0.5 * warm], axis=2), np.float32)
    fine = 0.6 if ground is Ground.CONCRETE else 0.3
    one = fine * _noise(rng, grain_px) + 0.6 * _noise(rng, 30 * grain_px)
    return np.repeat(np.asarray(one, np.float32)[:, :, None], 3, axis=2)


def _noise(rng: np.random.Generator, across_px: float, along_px: float | None = None) -> Plane:
    """Return Gaussian noise with grains of a size, with a standard deviation of 1."""
    sigma_y, sigma_x = 0.4 * across_px, 0.4 * (along_px or across_px)
    # Coarse noise is made coarse, and spread out.
    rows, columns = (max(16, min(TEXTURE_PX, round(TEXTURE_PX * 2 / sigma))) for sigma in (sigma_y, sigma_x))
    white = rng.standard_normal((rows, columns), dtype=np.float32)
    soft = cv2.GaussianBlur(
        white,
        (0, 0),
        sigmaX=sigma_x * columns / TEXTURE_PX,
        sigmaY=sigma_y * rows / TEXTURE_PX,
        borderType=cv2.BORDER_REFLECT_101,
    )
    spread = cv2.resize(soft, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_LINEAR)
    return np.asarray(spread / spread.std(), np.float32)


def _leaning(texture: Plane, degrees: float) -> Plane:
    turn = cv2.getRotationMatrix2D((TEXTURE_PX / 2, TEXTURE_PX / 2), 90 + degrees, 1.0)
    return np.asarray(cv2.warpAffine(texture, turn, texture.shape[::-1], borderMode=cv2.BORDER_REFLECT), np.float32)


def _slanted(texture: Plane, width_px: int, height_px: int, slant: float) -> Plane:
    """Return a texture as a floor: at the top of the picture everything is smaller."""
    w, h, side = width_px, height_px, TEXTURE_PX
    half_top = min(w / (2 * (1 - 0.7 * slant)), side / 2 - 1)
    half_bottom = w / 2 * 0.9
    depth = min(h * (1 + slant), side - 2)
    middle = side / 2
    source = np.array(
        [
            (middle - half_top, middle - depth / 2),
            (middle + half_top, middle - depth / 2),
            (middle + half_bottom, middle + depth / 2),
            (middle - half_bottom, middle + depth / 2),
        ],
        np.float32,
    )
    corners = np.array([(0, 0), (w, 0), (w, h), (0, h)], np.float32)
    warp = cv2.getPerspectiveTransform(source, corners)
    return np.asarray(
        cv2.warpPerspective(texture, warp, (w, h), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REFLECT_101), np.float32
    )


# A shadow that falls across a target and what is behind it alike.
