"""What a real ball's surface shows: stripes, a seam, a logo, dirt and felt.

A surface is a map from the sphere to albedo. It is given by unit vectors in the ball's own frame, which a random
rotation turns to the camera's.
"""

from __future__ import annotations

import math
from enum import StrEnum
from functools import cache, lru_cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from support.scenes.target import Colour
from support.scenes.tone import decode_srgb

Plane = NDArray[np.float32]

SEAM_POINTS = 240
SEAM_HALF_RAD = 0.045
STRIPE_HALF_RAD = (0.05, 0.2)
DIRT_FREQUENCY, FELT_FREQUENCY = 3.0, 40.0
"""Waves of dirt and of felt on one radius of the ball."""

TEXTURE_PX = 256
FUZZ_ORDERS, FUZZ_TERMS = range(3, 60), 16
"""Waves around the limb of a felt ball: tufts of a twentieth to a sixtieth of its outline."""


class Marking(StrEnum):
    """What is printed or sewn on a ball."""

    NONE = "plain"
    STRIPES = "stripes"
    SEAM = "seam"
    LOGO = "logo"
    PATCHES = "patches"


class BallSurface(Struct, frozen=True, kw_only=True):
    """The surface of one ball.

    Attributes:
        bgr: Its main colour.
        marking: What is on it.
        marking_bgr: The colour of that: of stripes and seams paler than the ball.
        dirt: How much darker its dirtiest places are, from 0 to 1.
        felt: Standard deviation of the limb's radius as a share of it; the limb is as soft as that as well. 0 for a
            smooth ball.
        seed: Where the markings lie.
    """

    bgr: Colour
    marking: Marking = Marking.NONE
    marking_bgr: Colour = (225, 230, 228)
    dirt: float = 0.0
    felt: float = 0.0
    seed: int = 0

    def albedo(self, normal: tuple[Plane, Plane, Plane]) -> Plane:
        """Return the share of light that comes back from places with these outward normals, shape ``(h, w, 3)``."""
        place = np.stack(normal, axis=-1) @ _rotation(self.seed).astype(np.float32)
        main, other = decode_srgb(self.bgr), decode_srgb(self.marking_bgr)
        share = self._marked(place)[..., None]
        colour = main + share * (other - main)
        colour *= np.float32(1) - np.float32(self.dirt) * _waves(place, self.seed, DIRT_FREQUENCY)[..., None]
        if self.felt > 0:
            colour *= np.float32(0.85) + np.float32(0.3) * _waves(place, self.seed + 1, FELT_FREQUENCY)[..., None]
        return np.asarray(colour, np.float32)

    def limb_share(self, angle_rad: Plane) -> Plane:
        """Return the radius of the limb around the ball as a share of the mean one: felt makes it ragged."""
        if self.felt == 0:
            return np.ones_like(angle_rad)
        rng = np.random.default_rng((self.seed, 51))
        orders = rng.choice(np.array(FUZZ_ORDERS), FUZZ_TERMS, replace=False)
        around = np.linspace(-math.pi, math.pi, 1441)
        waves = np.cos(np.outer(orders, around) + rng.uniform(0, 2 * math.pi, FUZZ_TERMS)[:, None])
        share = 1 + self.felt * math.sqrt(2 / FUZZ_TERMS) * waves.sum(axis=0)
        return np.interp(angle_rad, around, share).astype(np.float32)

    def _marked(self, place: Plane) -> Plane:
        """Return how much of each place is covered by the marking, from 0 to 1."""
        rng = np.random.default_rng((self.seed, 52))
        if self.marking is Marking.STRIPES:
            count, shares = int(rng.integers(1, 4)), []
            for _ in range(count):
                axis, middle = _unit(rng), float(rng.uniform(-0.7, 0.7))
                shares.append(_soft(float(rng.uniform(*STRIPE_HALF_RAD)) - np.abs(place @ axis - middle)))
            return np.max(shares, axis=0)
        if self.marking is Marking.SEAM:
            nearest = np.max(place @ _seam().T, axis=-1)
            return _soft(SEAM_HALF_RAD - np.arccos(np.clip(nearest, -1, 1)))
        if self.marking is Marking.PATCHES:
            centres = np.array([_unit(rng) for _ in range(int(rng.integers(4, 13)))], np.float32)
            angle = np.arccos(np.clip(np.max(place @ centres.T, axis=-1), -1, 1))
            return _soft(float(rng.uniform(0.15, 0.4)) - angle)
        if self.marking is Marking.LOGO:
            return self._logo(place, rng)
        return np.zeros(place.shape[:-1], np.float32)

    def _logo(self, place: Plane, rng: np.random.Generator) -> Plane:
        """Return letters of bars within a band, on the side that faces the camera or not."""
        x, y = np.arctan2(place[..., 0], -place[..., 2]), place[..., 1]
        share = np.zeros(place.shape[:-1], np.float32)
        for letter in range(5):
            left = -0.75 + 0.32 * letter
            bars = [(left, -0.2, left + 0.06, 0.2), (left, float(rng.choice([-0.2, -0.03, 0.14])), left + 0.22, 0.0)]
            for x0, y0, x1, y1 in bars:
                bar = np.minimum.reduce([x - x0, x1 - x, y - y0, max(y1, y0 + 0.06) - y])
                share = np.maximum(share, _soft(bar))
        return share


def _soft(depth: Plane) -> Plane:
    """Return how much a place is inside an edge that is soft over a hundredth of the radius."""
    return np.clip(depth / 0.01 + 0.5, 0, 1).astype(np.float32)


def _waves(place: Plane, seed: int, frequency: float) -> Plane:
    """Return smooth noise on the sphere, from 0 to 1."""
    # The sum of three textures, each seen along one axis: smooth everywhere, and as rough in every direction.
    texture = _texture(seed, frequency)
    middle, x, y, z = np.float32((TEXTURE_PX - 1) / 2), *cv2.split(place)
    total = sum(
        cv2.remap(each, (a + 1) * middle, (b + 1) * middle, cv2.INTER_LINEAR)
        for each, a, b in zip(texture, (x, y, z), (y, z, x), strict=True)
    )
    return np.clip(0.5 + total / 3, 0, 1).astype(np.float32)


@lru_cache(maxsize=4)
def _texture(seed: int, frequency: float) -> Plane:
    """Return three textures of smooth noise, with standard deviations of 1, shape ``(3, n, n)``."""
    white = np.random.default_rng((seed, 53)).standard_normal((3, TEXTURE_PX, TEXTURE_PX), dtype=np.float32)
    soft = np.stack([cv2.GaussianBlur(each, (0, 0), TEXTURE_PX / (4 * frequency)) for each in white])
    return np.asarray(soft / soft.std(), np.float32)


def _unit(rng: np.random.Generator) -> Plane:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector), np.float32)


def _rotation(seed: int) -> NDArray[np.float64]:
    rotation, _ = np.linalg.qr(np.random.default_rng((seed, 54)).standard_normal((3, 3)))
    return np.asarray(rotation)


@cache
def _seam() -> Plane:
    """Return points on the seam of a tennis ball: x = a cos t + b cos 3t and so on with a = 3/4, b = 1/4."""
    t, a, b = np.linspace(0, 2 * math.pi, SEAM_POINTS, endpoint=False), 0.75, 0.25
    curve = (a * np.cos(t) + b * np.cos(3 * t), a * np.sin(t) - b * np.sin(3 * t), 2 * math.sqrt(a * b) * np.sin(2 * t))
    points = np.stack(curve, axis=1)
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True), np.float32)
