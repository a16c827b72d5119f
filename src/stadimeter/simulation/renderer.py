"""What the simulated camera sees."""

from __future__ import annotations

import cv2
import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.simulation.noise import scramble
from stadimeter.simulation.painted_ball import paint_ball, paint_shadow
from stadimeter.simulation.room import Room
from stadimeter.simulation.silhouette import Vector

SPARE_PX = 64
"""By so much the noise is larger than a picture each way: 4096 places to cut it from."""


class Renderer:
    """Draws pictures through a pinhole: a room, a ball in it, and the sensor's noise.

    The same arguments always give the same picture.

    Args:
        camera_height_m: Height of the camera above the floor.
        seed: The room and the noise follow from it.
        noise: Standard deviation of the sensor's noise in grey levels of 255.
    """

    def __init__(self, model: CameraModel, *, camera_height_m: float, seed: int, noise: float) -> None:
        self._model = model
        self._camera_height_m = camera_height_m
        self._room = Room(model, camera_height_m, seed)
        self._noise = _SensorNoise(model, seed, noise) if noise > 0 else None

    def render(self, ball_m: Vector | None, radius_m: float, heading_rad: float, sequence: int = 0) -> Image:
        """Draw a picture.

        Args:
            ball_m: The ball's centre in the camera frame: x right, y down, z forward; None for no ball.
            heading_rad: Where the camera looks, counter-clockwise from east.
            sequence: The frame's number, from which its noise follows.

        Returns:
            A new picture, shape ``(height, width, 3)``, blue first.
        """
        image = self._room.view(heading_rad)
        if ball_m is not None:
            paint_shadow(image, self._model, ball_m, radius_m, self._camera_height_m)
            paint_ball(image, self._model, ball_m, radius_m)
        if self._noise:
            self._noise.add_to(image, sequence)
        return image


class _SensorNoise:
    """Gaussian noise, made once: each frame cuts its own from a larger sheet.

    Brighter and darker are kept apart, so that adding is two saturating additions of bytes.
    """

    def __init__(self, model: CameraModel, seed: int, sigma: float) -> None:
        self._seed = seed
        shape = (model.height_px + SPARE_PX, model.width_px + SPARE_PX, 3)
        sheet = np.random.default_rng((seed, 1)).standard_normal(shape, dtype=np.float32) * np.float32(sigma)
        self._brighter = np.clip(np.rint(sheet), 0, 255).astype(np.uint8)
        self._darker = np.clip(np.rint(-sheet), 0, 255).astype(np.uint8)

    def add_to(self, image: Image, sequence: int) -> None:
        bits = scramble(self._seed, sequence)
        top, left = bits % SPARE_PX, (bits >> 16) % SPARE_PX
        rows, columns = slice(top, top + image.shape[0]), slice(left, left + image.shape[1])
        cv2.add(image, self._brighter[rows, columns], dst=image)
        cv2.subtract(image, self._darker[rows, columns], dst=image)
