"""An ellipse in a picture."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.detectors.sampling import Light, light_table
from stadimeter.ranging.circle_pose import cone_through

# Takes points from where they would be without the lens's distortion to where they are in the picture.
Values = NDArray[np.float64]
Matrix = NDArray[np.float64]
Bend = Callable[[Points], Points]

# An ellipse is taken through the lens by this many points around it.
RIM_POINTS = 32

# Half axes shorter than this are no ellipse in a picture.
MIN_HALF_AXIS_PX = 0.5


@cache
def turns(count: int) -> Points:
    """Return points evenly around the unit circle, shape ``(count, 2)``. Read-only."""
    angles = np.linspace(0, 2 * math.pi, count, endpoint=False)
    places = np.column_stack((np.cos(angles), np.sin(angles)))
    places.setflags(write=False)
    return places


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rim:
    """Places around an ellipse."""

    turns: Points  # the cosine and sine that each belongs to, shape ``(n, 2)``
    points_px: Points  # where they are, x and y, shape ``(n, 2)``
    outward: Points  # the unit vectors at right angles to the ellipse there, shape ``(n, 2)``
    curvature: Values  # one over the radius of the circle that follows the ellipse there, in 1/px, shape ``(n,)``


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Ellipse:
    """The points ``c + M (cos t, sin t)`` with M symmetric: five numbers, none of which is undefined for a circle."""

    centre_px: Points  # c, x and y, shape ``(2,)``
    half_axes_px: Matrix  # M, shape ``(2, 2)``; its eigenvalues are the half axes, its eigenvectors their directions

    def axes(self) -> tuple[float, float, tuple[float, float]]:
        """Return the larger and the smaller half axis in pixels, and the unit vector along the larger one."""
        (xx, xy), (_, yy) = self.half_axes_px.tolist()
        # Eigenvalues of a symmetric 2x2 matrix: the mean of its diagonal, more and less by the radius of Mohr's circle;
        # the eigenvector is at half the angle.
        middle, apart = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
        angle = math.atan2(xy, (xx - yy) / 2) / 2
        return middle + apart, middle - apart, (math.cos(angle), math.sin(angle))

    def rim(self, count: int) -> Rim:
        """Return points around it, the closer together the more it bends there."""
        circle = turns(count)
        (xx, xy), (_, yy) = self.half_axes_px
        area = xx * yy - xy * xy
        # The normal is along the inverse of M times (cos t, sin t); times the determinant, it has the tangent's length.
        steep = circle @ np.array(((yy, -xy), (-xy, xx)))
        speed = np.hypot(steep[:, 0], steep[:, 1])
        return Rim(
            turns=circle,
            points_px=circle @ self.half_axes_px + self.centre_px,
            outward=steep / speed[:, None],
            curvature=area / speed**3,
        )

    def distances_px(self, points_px: Points) -> Values:
        """Return about how far outside of it points are, inside negative, along the line to its centre."""
        (xx, xy), (_, yy) = self.half_axes_px.tolist()
        area = xx * yy - xy * xy
        x, y = points_px[:, 0] - self.centre_px[0], points_px[:, 1] - self.centre_px[1]
        # |M⁻¹ (p - c)|: 1 on the ellipse, and the share of the way from the centre to it elsewhere.
        share = np.hypot(yy * x - xy * y, xx * y - xy * x) / area
        return np.asarray(np.hypot(x, y) * (1 - 1 / np.maximum(share, 1e-9)))

    def perimeter_px(self) -> float:
        """Return about how long it is all around (S. Ramanujan's first approximation)."""
        a, b, _ = self.axes()
        return math.pi * (3 * (a + b) - math.sqrt((3 * a + b) * (a + 3 * b)))


def ellipse_from_moments(
    area: float, centre: tuple[float, float], spread: tuple[float, float, float]
) -> Ellipse | None:
    """Return the ellipse with the central second moments xx, xy and yy of a shape, in px⁴; None if it has no width.

    A full ellipse with the half axes M has the covariance ``M² / 4``.
    """
    xx, xy, yy = (4 * each / area for each in spread)
    # The root of a symmetric 2x2 matrix A is (A + sqrt(det A) 1) / sqrt(trace A + 2 sqrt(det A)).
    squared = xx * yy - xy * xy
    if not squared > MIN_HALF_AXIS_PX**4:
        return None
    root = math.sqrt(squared)
    half_axes = np.array(((xx + root, xy), (xy, yy + root))) / math.sqrt(xx + yy + 2 * root)
    return Ellipse(centre_px=np.array(centre), half_axes_px=half_axes)


def ellipse_through(points_px: Points) -> Ellipse | None:
    """Return the ellipse through points on most of it, by linear least squares; None if they are on none."""
    conic = cone_through(points_px)
    if conic is None:
        return None
    # Centre: where the gradient of the conic vanishes. Divided by its value there, the eigenvalues of the quadratic
    # part are 1 / a² and 1 / b².
    centre = -np.linalg.solve(conic[:2, :2], conic[:2, 2])
    value = -float(conic[2, 2] + conic[2, :2] @ centre)
    if not value > 0:
        return None
    shares, directions = np.linalg.eigh(conic[:2, :2] / value)
    half_axes = np.asarray(1 / np.sqrt(shares), np.float64)
    if not half_axes.min() > MIN_HALF_AXIS_PX:
        return None
    return Ellipse(centre_px=np.asarray(centre), half_axes_px=(directions * half_axes) @ directions.T)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Lens:
    """Leads between places in a picture and where they would be without distortion."""

    # The camera at the picture's resolution; None if it is not known, and then nothing is bent.
    camera: CameraModel | None

    @property
    def light(self) -> Light:
        """The light of code values through the camera's tone curve; that of sRGB if it is not known."""
        return light_table("srgb" if self.camera is None else self.camera.tone_curve)

    @property
    def is_compressed(self) -> bool:
        """Whether pictures store colour at a lower resolution than brightness, as JPEG does."""
        return self.camera is not None and self.camera.chroma_pitch_px != (1, 1)

    @property
    def bend(self) -> Bend | None:
        """The lens's distortion; None if it has none."""
        return self.bent if self.camera is not None and self.camera.distortion else None

    def bent(self, points_px: Points) -> Points:
        """Return where points appear, any shape that ends with x and y."""
        if self.camera is None or not self.camera.distortion:
            return points_px
        straight = (points_px.reshape(-1, 2) - self._centre()) / self._focal()
        return self.camera.project(straight).reshape(points_px.shape)

    def straighten(self, ellipse: Ellipse) -> Ellipse | None:
        """Return the ellipse that appears as one; None for one that none appears as."""
        if self.camera is None or not self.camera.distortion:
            return ellipse
        # An ellipse bent by the lens is none any more: 32 points are undone one by one, and an ellipse is fitted
        # through them. It is a start only.
        straight = self.camera.directions(ellipse.rim(RIM_POINTS).points_px) * self._focal() + self._centre()
        return ellipse_through(straight)

    def _focal(self) -> Points:
        return np.array([self.camera.fx_px, self.camera.fy_px]) if self.camera else np.ones(2)

    def _centre(self) -> Points:
        return np.array([self.camera.cx_px, self.camera.cy_px]) if self.camera else np.zeros(2)
