"""Floors that a ball lies on: carpet, wood, concrete and grass, with the ball's shadow; and walls as bright as it."""

from __future__ import annotations

import math
from enum import StrEnum

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from support.scenes.backdrop import KeepOut
from support.scenes.target import Colour
from support.scenes.tone import decode_srgb

Plane = NDArray[np.float32]

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
