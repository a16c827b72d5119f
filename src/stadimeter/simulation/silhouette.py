"""A ball through a pinhole: its exact outline, and its picture.

The rays that touch a ball form a cone, and the picture plane cuts the cone in an ellipse. With the ball's centre at
``c`` and its radius ``r``, a ray ``d`` hits the ball if ``(d·c)² >= |d|² (|c|² - r²)``; the dual of that conic is ``c
cᵀ - r² I``, from which its extent follows (R. Hartley and A. Zisserman, "Multiple View Geometry", section 8.3). Seen
along the plane through the optical axis and the ball's centre, the ellipse is longest; across it is ``r / sqrt(z² -
r²)`` per unit of depth, which is what similar triangles want.

In a picture each pixel's ray is intersected with the sphere, and the edge is anti-aliased exactly.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.frame import Image

Vector = tuple[float, float, float]
Plane = NDArray[np.float32]

# Nearer to the axis than this, rounding leaves nothing of the direction, and the outline is a circle anyway.
NO_DIRECTION_M = 1e-12

# The yellowish green of a tennis ball. Shading scales all three alike, so hue and saturation hold on the dark side.
BALL_BGR = (52, 232, 190)

# The direction of the light, in the camera frame: from above, from the left and from behind the camera.
LIGHT = (-0.37, -0.83, -0.42)

MIN_SHADE = 0.42

# A ball of fewer samples across is sampled more finely.
FINE_PX = 96

SHADOW_DEPTH = 0.5


class Silhouette(Struct, frozen=True, kw_only=True):
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
    """Check whether a ray, x and y per unit of depth, hits a ball in the camera frame, the limb included."""
    (u, v), (x, y, z) = direction, centre_m
    ahead = u * x + v * y + z
    return ahead > 0 and ahead * ahead >= (u * u + v * v + 1) * (x * x + y * y + z * z - radius_m * radius_m)


class _Patch(Struct, frozen=True, kw_only=True):
    """A part of a picture, in whole pixels, right and bottom excluded."""

    left: int
    top: int
    right: int
    bottom: int

    def of(self, image: Image) -> Image:
        return image[self.top : self.bottom, self.left : self.right]

    def rays(self, model: CameraModel, finer: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return x and y per unit of depth of its columns and rows, with ``finer`` of them in a pixel."""
        columns = self.left + (np.arange((self.right - self.left) * finer) + 0.5) / finer - 0.5
        rows = self.top + (np.arange((self.bottom - self.top) * finer) + 0.5) / finer - 0.5
        return (columns - model.cx_px) / model.fx_px, (rows - model.cy_px) / model.fy_px


def _patch(model: CameraModel, extent_px: tuple[float, float, float, float]) -> _Patch | None:
    left, top = max(0, math.floor(extent_px[0])), max(0, math.floor(extent_px[1]))
    right, bottom = min(model.width_px, math.ceil(extent_px[2]) + 1), min(model.height_px, math.ceil(extent_px[3]) + 1)
    return _Patch(left=left, top=top, right=right, bottom=bottom) if left < right and top < bottom else None


def paint_ball(image: Image, model: CameraModel, centre_m: Vector, radius_m: float) -> None:
    """Paint a ball into a picture; its centre is in the camera frame: x right, y down, z forward."""
    if centre_m[2] <= -radius_m:
        return
    seen = silhouette(model, centre_m, radius_m)
    extent_px = seen.extent_px if seen else (0.0, 0.0, float(model.width_px), float(model.height_px))
    patch = _patch(model, extent_px)
    if patch is None:
        return
    across_px = max(extent_px[2] - extent_px[0], extent_px[3] - extent_px[1])
    finer = max(1, min(8, math.ceil(FINE_PX / across_px)))
    middle_px = seen.centre_px if seen else (model.cx_px, model.cy_px)
    cover, shade = _cast(patch.rays(model, finer), model.direction(*middle_px), centre_m, radius_m)
    size = (patch.right - patch.left, patch.bottom - patch.top)
    layers = cv2.resize(cv2.merge((cover, cover * shade)), size, interpolation=cv2.INTER_AREA).reshape(*size[::-1], 2)
    behind = patch.of(image) * (1 - layers[:, :, :1])
    behind += layers[:, :, 1:] * np.array(BALL_BGR, np.float32) + 0.5
    patch.of(image)[:] = behind.astype(np.uint8)


def _cast(
    rays: tuple[NDArray[np.float64], NDArray[np.float64]],
    middle: tuple[float, float],
    centre_m: Vector,
    radius_m: float,
) -> tuple[Plane, Plane]:
    """Return the share of each sample that the ball covers, and how brightly it shines there.

    A ray hits where ``g = (d·c)² - |d|² (|c|² - r²)`` is positive. That is a polynomial in the ray's x and y; it is
    developed around the middle of the silhouette, so that single precision is enough however far the ball is.
    """
    (x, y, z), (u0, v0) = centre_m, middle
    power = x * x + y * y + z * z - radius_m * radius_m
    ahead0 = u0 * x + v0 * y + z
    du = (rays[0] - u0).astype(np.float32)[None, :]
    dv = (rays[1] - v0).astype(np.float32)[:, None]
    slope_u, slope_v = 2 * (ahead0 * x - power * u0), 2 * (ahead0 * y - power * v0)
    bend_u, bend_v, twist = x * x - power, y * y - power, 2 * x * y
    middle_g = ahead0 * ahead0 - (u0 * u0 + v0 * v0 + 1) * power
    g = (bend_u * du * du + slope_u * du + middle_g) + (bend_v * dv * dv + slope_v * dv) + dv * (twist * du)
    per_u = (((2 * bend_u) * du + slope_u) + twist * dv) * _step(rays[0])
    per_v = (((2 * bend_v) * dv + slope_v) + twist * du) * _step(rays[1])
    inside_samples = g / (cv2.magnitude(per_u, per_v) + np.float32(1e-12))
    ahead = (x * du + ahead0) + y * dv
    cover = np.clip(inside_samples + np.float32(0.5), 0, 1) * (ahead > 0)
    squared = (rays[0] ** 2 + 1).astype(np.float32)[None, :] + (rays[1] ** 2).astype(np.float32)[:, None]
    depth_m = (ahead - np.sqrt(np.maximum(g, 0))) / squared
    return cover, _shade(depth_m, rays, centre_m, radius_m)


def _step(rays: NDArray[np.float64]) -> np.float32:
    """Return the distance between two samples; of a ball of which one column or row is in the picture, none is known.

    Its edge is then as sharp as a sample.
    """
    return np.float32(abs(float(rays[1] - rays[0])) if len(rays) > 1 else 0.0)


def _shade(
    depth_m: Plane, rays: tuple[NDArray[np.float64], NDArray[np.float64]], centre_m: Vector, radius_m: float
) -> Plane:
    """Return the brightness of a matte surface by Lambert's cosine law, with some light from all sides."""
    light_x, light_y, light_z = (part / math.hypot(*LIGHT) for part in LIGHT)
    along = (light_x * rays[0] + light_z).astype(np.float32)[None, :] + (light_y * rays[1]).astype(np.float32)[:, None]
    behind_m = light_x * centre_m[0] + light_y * centre_m[1] + light_z * centre_m[2]
    cosine = (depth_m * along - np.float32(behind_m)) * np.float32(1 / radius_m)
    shade: Plane = np.clip(cosine, 0, 1) * np.float32(1 - MIN_SHADE) + np.float32(MIN_SHADE)
    return shade


def paint_shadow(image: Image, model: CameraModel, centre_m: Vector, radius_m: float, camera_height_m: float) -> None:
    """Darken the floor under a ball; its centre is in the camera frame: x right, y down, z forward."""
    x, y, z = centre_m
    reach_m = 2 * radius_m
    near_m = z - reach_m
    if near_m < reach_m:
        return
    sides = [(x + side) / depth for side in (-reach_m, reach_m) for depth in (near_m, z + reach_m)]
    extent_px = (
        model.cx_px + model.fx_px * min(sides),
        model.cy_px + model.fy_px * camera_height_m / (z + reach_m),
        model.cx_px + model.fx_px * max(sides),
        model.cy_px + model.fy_px * camera_height_m / near_m,
    )
    patch = _patch(model, extent_px)
    if patch is None:
        return
    columns, rows = patch.rays(model, 1)
    depth_m = camera_height_m / np.maximum(rows, 1e-6)[:, None]
    off_squared = ((columns[None, :] * depth_m - x) ** 2 + (depth_m - z) ** 2) / radius_m**2
    gap = max(0.0, camera_height_m - y - radius_m) / radius_m
    light = 1 - SHADOW_DEPTH * math.exp(-gap) * np.exp(-1.5 * off_squared)
    patch.of(image)[:] = (patch.of(image) * light[:, :, None].astype(np.float32) + 0.5).astype(np.uint8)
