"""A shadow that falls across a target and what is behind it alike."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from support.scenes.backdrop import Backdrop, KeepOut
from support.scenes.lens import Floats

Plane = NDArray[np.float32]


class Shadow(Struct, frozen=True, kw_only=True):
    """The shadow of something with a straight edge, by ray.

    Attributes:
        through: A ray on its edge: x and y per unit of depth.
        from_rad: The side that is dark, from right towards down.
        softness: Width of the half-shadow, per unit of depth.
        depth: The share of the light that is missing in it.
    """

    through: tuple[float, float]
    from_rad: float
    softness: float = 0.02
    depth: float = 0.5

    def left_over(self, x: Floats, y: Floats) -> Plane:
        """Return the share of light that is left along rays."""
        ahead, aside = math.cos(self.from_rad), math.sin(self.from_rad)
        deep = (x - self.through[0]) * ahead + (y - self.through[1]) * aside
        share = np.clip(deep / self.softness + 0.5, 0, 1)
        return np.asarray(1 - self.depth * share * share * (3 - 2 * share), np.float32)


class ShadedBackdrop(Struct, frozen=True, kw_only=True):
    """A backdrop with a shadow on it.

    Attributes:
        inner: The backdrop.
        shadow: The shadow.
        camera: The camera that looks at it; its distortion is left out.
    """

    inner: Backdrop
    shadow: Shadow
    camera: CameraModel

    @property
    def avoids_target(self) -> bool:
        """As the inner one."""
        return self.inner.avoids_target

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> Plane:
        """Return its linear light."""
        light = self.inner.light(width_px, height_px, seed, keep_out)
        x = (np.arange(width_px)[None, :] - self.camera.cx_px) / self.camera.fx_px
        y = (np.arange(height_px)[:, None] - self.camera.cy_px) / self.camera.fy_px
        return np.asarray(light * self.shadow.left_over(x, y)[:, :, None], np.float32)
