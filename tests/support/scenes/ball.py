"""Balls, and what is printed on them."""

from __future__ import annotations

import math
from enum import StrEnum
from functools import cache, lru_cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.simulation.camera import Vector, silhouette
from support.scenes.target import Colour, Floats, Layer, Rays, inside
from support.scenes.tone import decode_srgb

# What a real ball's surface shows: stripes, a seam, a logo, dirt and felt.
#
# A surface is a map from the sphere to albedo. It is given by unit vectors in the ball's own frame, which a random
# rotation turns to the camera's.

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


# A ball, by casting rays.
#
# A ray d hits the sphere of radius r about c if ``(d·c)² >= |d|² (|c|² - r²)``, see `stadimeter.simulation.camera`.

TENNIS_BGR: Colour = (52, 232, 190)
"""The yellowish green of a tennis ball."""

LIMB_POINTS = 360
SHININESS = 24.0
"""Phong's exponent: the highlight is about a quarter of the ball wide."""


class BallTarget(Struct, frozen=True, kw_only=True):
    """A matte sphere in the light of a far lamp and of its surroundings.

    Attributes:
        position_m: Its centre in the camera frame.
        diameter_m: Its diameter.
        bgr: Its colour.
        light: Where the lamp is, any length.
        ambient: The share of the light that comes from all sides: how bright the dark side is.
        specular: How bright the lamp's reflection is, 1 for white; 0 for none.
        surface: Markings, dirt and felt; None for a smooth ball of one colour.
        floor_bgr: Colour of the floor that it lies on: its lower side is lit by that instead of from all sides, and
            darkest where it touches; None for a ball in the air.
        mirror: The share of its light that is the picture of its surroundings, bright above and dark below, as on a
            silver ball; 0 for a matte one.
    """

    position_m: Vector
    diameter_m: float
    bgr: Colour = TENNIS_BGR
    light: Vector = (-0.37, -0.83, -0.42)
    ambient: float = 0.4
    specular: float = 0.0
    surface: BallSurface | None = None
    floor_bgr: Colour | None = None
    mirror: float = 0.0

    @property
    def tilt_rad(self) -> float:
        """A ball has no tilt."""
        return 0.0

    def outline_m(self) -> Points:
        """Return where rays touch the ball: a circle, nearer than the centre."""
        centre = np.array(self.position_m)
        distance, radius = float(np.linalg.norm(centre)), self.diameter_m / 2
        first = np.cross(centre, (0.0, 1.0, 0.0) if abs(centre[0]) + abs(centre[2]) > 0 else (1.0, 0.0, 0.0))
        first /= np.linalg.norm(first)
        second = np.cross(centre / distance, first)
        angles = np.linspace(0, 2 * math.pi, LIMB_POINTS, endpoint=False)[:, None]
        around = np.cos(angles) * first + np.sin(angles) * second
        sine = radius / distance
        return np.asarray(centre * (1 - sine**2) + around * radius * math.sqrt(1 - sine**2))

    def extent_m(self) -> Points:
        """Return the limb."""
        return self.outline_m()

    def apparent_px(self, camera: CameraModel) -> float:
        """Return the smaller diameter of its outline, which does not depend on where in the picture it is."""
        seen = silhouette(camera, self.position_m, self.diameter_m / 2)
        return 2 * seen.half_across_px[0] if seen else math.inf

    def layer(self, rays: Rays) -> Layer:
        """Return what it covers, and its light by Lambert's cosine law with Phong's reflection."""
        (u, v), (x, y, z), radius = rays, self.position_m, self.diameter_m / 2
        squared = u * u + v * v + 1
        ahead = u * x + v * y + z
        power = x * x + y * y + z * z - radius * radius
        hit = ahead * ahead - squared * power
        cover = (self._felt_cover(rays, ahead, squared) if self._is_felt else inside(hit)) * (ahead > 0)
        light = np.zeros((*cover.shape, 3), np.float32)
        box = _box(cover)
        light[box] = self._light(self._normal(u[box], v[box], ahead[box], squared[box], hit[box]), u[box], v[box])
        return Layer(cover.astype(np.float32), light)

    def _normal(self, u: Floats, v: Floats, ahead: Floats, squared: Floats, hit: Floats) -> tuple[Plane, ...]:
        """Return which way the ball's surface faces where rays hit it; beyond the limb, where they come nearest."""
        depth = (ahead - np.sqrt(np.maximum(hit, 0))) / squared
        places = zip((u, v, np.float64(1.0)), self.position_m, strict=True)
        normal = [((depth * part - centre) / (self.diameter_m / 2)).astype(np.float32) for part, centre in places]
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        return normal[0] / length, normal[1] / length, normal[2] / length

    @property
    def _is_felt(self) -> bool:
        return self.surface is not None and self.surface.felt > 0

    def _felt_cover(self, rays: Rays, ahead: Floats, squared: Floats) -> Plane:
        """Return how much a ragged, soft limb covers: half at the ball's radius on the average around it."""
        (u, v), (x, y, z) = rays, self.position_m
        distance = math.hypot(x, y, z)
        angle = np.arccos(np.clip(ahead / np.sqrt(squared) / distance, -1, 1))
        limb = math.asin(self.diameter_m / 2 / distance)
        around = np.arctan2(v - y / z, u - x / z).astype(np.float32)
        off = (self.surface.limb_share(around) - angle / limb).astype(np.float32)
        sample = np.float32(np.abs(np.diff(u[0])).max() / limb)
        return np.clip(off / (2 * self.surface.felt + sample) + 0.5, 0, 1).astype(np.float32)

    def _light(self, normal: tuple[Plane, ...], u: Floats, v: Floats) -> Plane:
        lamp = tuple(part / math.hypot(*self.light) for part in self.light)
        facing = sum(
            (n * np.float32(part) for n, part in zip(normal, lamp, strict=True)), np.zeros(u.shape, np.float32)
        )
        shade = np.float32(self.ambient) + np.float32(1 - self.ambient) * np.clip(facing, 0, 1)
        if self.surface is None:
            albedo = decode_srgb(self.bgr)
        else:
            albedo = self.surface.albedo((normal[0], normal[1], normal[2]))
        lit = np.repeat(shade[:, :, None], 3, axis=2)
        if self.floor_bgr is not None:
            below = np.clip(normal[1], 0, 1)[:, :, None]
            lit = lit * (1 - 0.75 * below**2) + 0.35 * below * decode_srgb(self.floor_bgr)
        light = lit * albedo
        if self.specular > 0:
            away = (u * lamp[0] + v * lamp[1] + lamp[2]).astype(np.float32)
            perceiver = (u * normal[0] + v * normal[1] + normal[2]).astype(np.float32)
            mirrored = (away - 2 * facing * perceiver) / np.sqrt(u * u + v * v + 1).astype(np.float32)
            light = light + np.float32(self.specular) * (np.clip(mirrored, 0, 1) ** np.float32(SHININESS))[:, :, None]
        if self.mirror > 0:
            # Down along the mirrored ray; what is above the horizon is brighter than the ball, what is below darker.
            perceived = (u * normal[0] + v * normal[1] + normal[2]) / np.sqrt(u * u + v * v + 1)
            down = v / np.sqrt(u * u + v * v + 1) - 2 * perceived * normal[1]
            around = np.float32(1) - np.float32(0.7) * np.tanh(3 * down).astype(np.float32)
            light = light * (1 - self.mirror + self.mirror * around[:, :, None])
        return np.asarray(light, np.float32)


def _box(cover: Plane) -> tuple[slice, slice]:
    """Return the rows and columns of samples that are covered at all."""
    rows, columns = np.flatnonzero(cover.any(axis=1)), np.flatnonzero(cover.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
