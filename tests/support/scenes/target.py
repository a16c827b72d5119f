"""What a thing in a scene must be able to do."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.simulation.silhouette import Vector
from support.scenes.lens import Floats, Rays

Plane = NDArray[np.float32]
Colour = tuple[int, int, int]
"""An sRGB colour as OpenCV has it: blue, green, red, 0 to 255. It is what the camera would show of it in full light."""


class Layer(Struct, frozen=True, eq=False):
    """What a target adds to samples.

    Attributes:
        cover: How much of each sample it covers, from 0 to 1, shape ``(h, w)``.
        light: The light that comes from it there, shape ``(h, w, 3)``, blue first.
    """

    cover: Plane
    light: Plane


class Target(Protocol):
    """A thing whose place and shape are known exactly."""

    @property
    def position_m(self) -> Vector:
        """Its centre in the camera frame: x right, y down, z forward."""
        ...

    @property
    def tilt_rad(self) -> float:
        """Angle between its normal and the optical axis; 0 for a ball."""
        ...

    def outline_m(self) -> Points:
        """Return points in the camera frame on what is measured: the corners of a sheet, the limb of a ball."""
        ...

    def extent_m(self) -> Points:
        """Return points around all of it that is drawn."""
        ...

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how large its diameter or longer side appears; of a flat one, as if it were not tilted."""
        ...

    def layer(self, rays: Rays) -> Layer:
        """Return what it adds to the samples that look along some rays."""
        ...


def inside(distance: Floats) -> Plane:
    """Return how much of each sample lies inside an edge.

    The distance to the edge in samples is the value over its own gradient; a straight edge at that distance covers
    that share of the sample. So the edge is exact to a small part of a sample.

    Args:
        distance: A smooth function, positive inside and zero on the edge, shape ``(h, w)``.

    Returns:
        From 0 to 1.
    """
    return np.clip(distance / slope(distance) + 0.5, 0, 1).astype(np.float32)


def slope(values: Floats) -> Floats:
    """Return how steep a function is, per sample."""
    down, across = np.gradient(values)
    return np.asarray(np.hypot(down, across) + 1e-300)
