"""The exact outline of a ball through a pinhole.

The rays that touch a ball form a cone, and the picture plane cuts the cone in an ellipse. With the ball's centre at
``c`` and its radius ``r``, a ray ``d`` hits the ball if ``(d·c)² >= |d|² (|c|² - r²)``; the dual of that conic is
``c cᵀ - r² I``, from which its extent follows (R. Hartley and A. Zisserman, "Multiple View Geometry", section 8.3).
Seen along the plane through the optical axis and the ball's centre, the ellipse is longest; across it is
``r / sqrt(z² - r²)`` per unit of depth, which is what similar triangles want.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points

Vector = tuple[float, float, float]


NO_DIRECTION_M = 1e-12
"""Nearer to the axis than this, rounding leaves nothing of the direction, and the outline is a circle anyway."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Silhouette:
    """The ellipse that a ball fills in a picture. Pixel coordinates have (0, 0) at the centre of the top left pixel."""

    centre_px: tuple[float, float]  # its centre, which lies a little further out than where the ball's centre is seen
    # Its half axis across the direction from the optical centre, in horizontal and vertical pixels.
    half_across_px: tuple[float, float]
    half_along_px: tuple[float, float]  # its half axis along that direction, likewise
    along: tuple[float, float]  # that direction as a unit vector, x right and y down
    extent_px: tuple[float, float, float, float]  # its bounding box: left, top, right, bottom

    def outline_px(self, cos_sin: Points, scale: float = 1.0) -> Points:
        """Return points on the ellipse, or one larger by a scale, from points on the unit circle, ``(n, 2)`` each."""
        (ax, ay), (bx, by), (ux, uy) = self.half_along_px, self.half_across_px, self.along
        axes = np.array(((ux * ax * scale, uy * ay * scale), (-uy * bx * scale, ux * by * scale)))
        outline: Points = cos_sin @ axes + self.centre_px
        return outline


def silhouette(model: CameraModel, centre_m: Vector, radius_m: float) -> Silhouette | None:
    """Return the ellipse that a ball fills in a picture, perhaps outside it; its centre is x right, y down, z forward.

    None if some of the ball is not in front of the camera.
    """
    x, y, z = centre_m
    if z <= radius_m:
        return None
    power = z * z - radius_m * radius_m
    off_axis = math.hypot(x, y)
    across = radius_m / math.sqrt(power)
    along = radius_m * math.sqrt(off_axis * off_axis + power) / power
    left, right = _extent(x, z, radius_m)
    top, bottom = _extent(y, z, radius_m)
    return Silhouette(
        centre_px=(model.cx_px + model.fx_px * x * z / power, model.cy_px + model.fy_px * y * z / power),
        half_across_px=(model.fx_px * across, model.fy_px * across),
        half_along_px=(model.fx_px * along, model.fy_px * along),
        along=(x / off_axis, y / off_axis) if off_axis > NO_DIRECTION_M else (1.0, 0.0),
        extent_px=(
            model.cx_px + model.fx_px * left,
            model.cy_px + model.fy_px * top,
            model.cx_px + model.fx_px * right,
            model.cy_px + model.fy_px * bottom,
        ),
    )


def _extent(sideways_m: float, z_m: float, radius_m: float) -> tuple[float, float]:
    power = z_m * z_m - radius_m * radius_m
    middle = sideways_m * z_m / power
    half = radius_m * math.sqrt(sideways_m * sideways_m + power) / power
    return (middle - half, middle + half)


def hits(direction: tuple[float, float], centre_m: Vector, radius_m: float) -> bool:
    """Return whether a ray, x and y per unit of depth, hits a ball in the camera frame, the limb included."""
    (u, v), (x, y, z) = direction, centre_m
    ahead = u * x + v * y + z
    return ahead > 0 and ahead * ahead >= (u * u + v * v + 1) * (x * x + y * y + z * z - radius_m * radius_m)
