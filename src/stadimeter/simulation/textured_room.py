"""A room in true perspective: unlike the backdrop, it shows that the camera drives, and not only that it turns."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image

# The room goes from -5 m to 5 m both ways and is 2.5 m high. A robot that drives through a wall is in the next such
# room, so that it may go anywhere.
HALF_ROOM_M = 5.0
CEILING_M = 2.5

# Its one texture covers 10.24 m and has a grey level every 2 cm; each wall shows another part of it.
TEXTURE_PX = 512
PX_PER_M = 50.0
WALLS_APART_M = 3.3

# Patterns of 8, 32 and 128 cm, with their shares of the contrast: carpets and wallpaper, pictures, furniture.
OCTAVES = ((4, 0.5), (16, 0.6), (64, 0.6))

# No yellow, no green, nothing dark, as in the backdrop.
PAINT_BGR = (168, 158, 150)
FLOOR_BGR = (132, 126, 122)
MIN_BRIGHTNESS, MAX_BRIGHTNESS = 60, 235

# The standard deviation of the grey levels of a room with carpets, pictures and furniture.
TEXTURE_CONTRAST = 24.0

Plane = NDArray[np.float32]


class TexturedRoom:
    """A room of floor, ceiling and four walls, seen through a pinhole.

    Args:
        contrast: Standard deviation of the grey levels of its texture; 0 for a plain room.
    """

    def __init__(self, model: CameraModel, camera_height_m: float, seed: int, contrast: float) -> None:
        self._texture = _paint(seed) * np.float32(contrast)
        self._sideways = ((np.arange(model.width_px) - model.cx_px) / model.fx_px).astype(np.float32)[None, :]
        self._down = ((np.arange(model.height_px) - model.cy_px) / model.fy_px).astype(np.float32)[:, None]
        self._camera_height_m = camera_height_m

    def view(self, heading_rad: float, place_m: tuple[float, float] = (0.0, 0.0), tilt_rad: float = 0.0) -> Image:
        """Draw what the camera sees from a place, as a new picture, blue first.

        Args:
            heading_rad: Where it looks, counter-clockwise from east.
            place_m: Where it is, to the east and to the north.
            tilt_rad: How far it looks up.
        """
        cos, sin = np.float32(math.cos(heading_rad)), np.float32(math.sin(heading_rad))
        level, up = np.float32(math.cos(tilt_rad)), np.float32(math.sin(tilt_rad))
        # Each pixel's direction per unit of the way over the floor, as a level camera has it.
        forward = np.maximum(level + self._down * up, np.float32(1e-3))
        sideways = self._sideways / forward if tilt_rad else self._sideways
        down = (self._down * level - up) / forward
        # The depth at which a row meets the floor, or above the horizon the ceiling.
        height_m = np.where(down > 0, self._camera_height_m, CEILING_M - self._camera_height_m)
        flat_m = (height_m / np.maximum(np.abs(down), 1e-6)).astype(np.float32)
        # Each column's direction over the floor, per unit of depth.
        east, north = cos + sideways * sin, sin - sideways * cos
        x_m, y_m = (np.float32(_in_room(each)) for each in place_m)
        to_x_m, to_y_m = _to_wall(x_m, east), _to_wall(y_m, north)
        wall_m = np.minimum(to_x_m, to_y_m)
        along_m = np.where(to_x_m < to_y_m, y_m + to_x_m * north, x_m + to_y_m * east)
        wall = np.where(to_x_m < to_y_m, 1 + (east > 0), 3 + (north > 0))
        is_wall = wall_m <= flat_m
        depth_m = np.where(is_wall, wall_m, flat_m)
        along_m = along_m + (wall * WALLS_APART_M).astype(np.float32)
        across_m = np.where(is_wall, along_m, x_m + depth_m * east)
        other_m = np.where(is_wall, self._camera_height_m - down * depth_m, y_m + depth_m * north)
        columns, rows = (np.asarray(each * PX_PER_M, np.float32) for each in (across_m, other_m))
        grey = cv2.remap(self._texture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        # Far away on the floor the texture is finer than pixels, and fades into its mean.
        grey *= np.where(is_wall, np.float32(1), np.clip(1.6 - depth_m / 3, 0, 1))
        levels = [
            np.where(is_wall, np.float32(wall_level), np.float32(floor_level)) + grey
            for wall_level, floor_level in zip(PAINT_BGR, FLOOR_BGR, strict=True)
        ]
        return np.asarray(np.clip(cv2.merge(levels), MIN_BRIGHTNESS, MAX_BRIGHTNESS), np.uint8)


def _in_room(place_m: float) -> float:
    return (place_m + HALF_ROOM_M) % (2 * HALF_ROOM_M) - HALF_ROOM_M


def _to_wall(place_m: np.float32, direction: Plane) -> Plane:
    """Return the depth at which each column meets the wall that it looks at, along one axis."""
    aside_m = np.where(direction > 0, HALF_ROOM_M - place_m, HALF_ROOM_M + place_m)
    return np.asarray(aside_m / np.maximum(np.abs(direction), 1e-6), np.float32)


def _paint(seed: int) -> Plane:
    """Return a pattern that repeats, with a mean of 0 and a standard deviation of 1."""
    rng = np.random.default_rng((seed, 2))
    painted = np.zeros((TEXTURE_PX, TEXTURE_PX), np.float32)
    for pitch_px, share in OCTAVES:
        coarse = rng.standard_normal((TEXTURE_PX // pitch_px, TEXTURE_PX // pitch_px)).astype(np.float32)
        wrapped = np.pad(coarse, 2, mode="wrap")
        wide = cv2.resize(wrapped, None, fx=pitch_px, fy=pitch_px, interpolation=cv2.INTER_CUBIC)
        painted += share * wide[2 * pitch_px : -2 * pitch_px, 2 * pitch_px : -2 * pitch_px]
    return np.asarray((painted - painted.mean()) / painted.std(), np.float32)
