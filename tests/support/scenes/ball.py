"""A ball, by casting rays.

A ray d hits the sphere of radius r about c if ``(d·c)² >= |d|² (|c|² - r²)``, see `stadimeter.simulation.silhouette`.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.simulation.silhouette import Vector, silhouette
from support.scenes.ball_surface import BallSurface
from support.scenes.lens import Floats, Rays
from support.scenes.target import Colour, Layer, inside
from support.scenes.tone import decode_srgb

Plane = NDArray[np.float32]

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

    def __post_init__(self) -> None:
        if not 0 < self.diameter_m / 2 < self.position_m[2]:
            raise ValueError(f"a ball of {self.diameter_m} m at {self.position_m} m is not in front of the camera")
        if not (0 <= self.ambient <= 1 and self.specular >= 0 and any(self.light)):
            raise ValueError(f"light {self.light}, ambient {self.ambient}, specular {self.specular} is no lighting")

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
