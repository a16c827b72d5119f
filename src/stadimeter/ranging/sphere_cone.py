"""The cone of rays that touch a sphere, from edge points of its outline.

Seen from a point, a sphere of radius r at distance D fills a circular cone about the line to its centre, of half angle
α with ``sin α = r / D``. Every unit ray d that touches it has the same angle to the unit axis a: ``d · a = cos α``.
With ``m = a / cos α`` this is *linear*: ``d · m = 1``, three unknowns. Then ``|m|² = 1 / cos² α`` and

    ``D = r / sqrt(1 - 1 / |m|²)``, the centre lies along ``m / |m|``.

Nothing is approximated: off the optical axis the outline in the picture is an ellipse, but the rays still form a
circular cone; and any part of the outline will do, so a ball may be partly hidden.

For a far ball all rays are nearly equal, and ``d · m = 1`` says nearly the same for each of them. So the rays are
described by where they pierce the plane at unit distance across a first guess of the axis, ``(u, v)``: with
``m = (1 + q0, q1, q2)`` in the frame of that guess, ``d · m = 1`` becomes

    ``q0 + q1 u + q2 v = sqrt(1 + u² + v²) - 1``,

which keeps all digits however small the ball.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points

Values = NDArray[np.float64]
Vector = tuple[float, float, float]

LEAST_RAYS = 6
"""Fewer rays say too little about three unknowns."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SphereCone:
    """The cone around a sphere. The camera frame is x right, y down, z forward.

    Attributes:
        axis: Unit vector towards the centre, in the camera frame.
        sine: Sine of the half angle: the sphere's radius as a share of its distance.
        sine_share: Standard deviation of `sine` as a share of it, for rays that err independently by one radian: to be
            multiplied by how much they do err.
    """

    axis: Vector
    sine: float
    sine_share: float

    def distance_m(self, radius_m: float) -> float:
        """Return how far away the centre of a sphere of a radius is."""
        return radius_m / self.sine

    @property
    def half_across(self) -> float:
        """The smaller half axis of the outline, per unit of focal length: ``sin α / sqrt(cos² θ - sin² α)``.

        θ is the angle between the cone's and the optical axis. Infinite for a sphere that reaches beside the camera.
        """
        ahead = self.axis[2] ** 2 - self.sine**2
        return self.sine / math.sqrt(ahead) if ahead > 0 and self.axis[2] > 0 else math.inf

    @property
    def outline_centre(self) -> tuple[float, float]:
        """The centre of the elliptical outline, x and y per unit of depth: further out than the sphere's centre."""
        x, y, z = self.axis
        ahead = max(z * z - self.sine**2, 1e-12)
        return x * z / ahead, y * z / ahead

    def outline(self, count: int) -> Points:
        """Return evenly spread rays that touch the sphere, as x and y per unit of depth, shape ``(count, 2)``."""
        x, y, z = self.axis
        along, across, down = _basis((x / z, y / z))
        angles = np.arange(count) * (2 * math.pi / count)
        around = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * down
        rays = math.sqrt(1 - self.sine**2) * np.array(along) + self.sine * around
        return np.asarray(rays[:, :2] / rays[:, 2:])


class ConeFrame:
    """Rays as seen along a first guess of the axis, ready to be fitted.

    Args:
        directions: Where the rays look to, x and y per unit of depth, shape ``(n, 2)``.
        towards: The first guess of the axis, x and y per unit of depth.
    """

    def __init__(self, directions: Points, towards: tuple[float, float]) -> None:
        self._basis = _basis(towards)
        a, b, c = self._basis
        x, y = directions[:, 0], directions[:, 1]
        ahead = x * a[0] + y * a[1] + a[2]
        u = (x * b[0] + y * b[1] + b[2]) / ahead
        v = (x * c[0] + y * c[1] + c[2]) / ahead
        squared = u * u + v * v
        self._length = np.sqrt(squared + 1)
        # Columns 1, u, v and the right side: one product with its transpose holds all sums of the normal equations.
        self._columns = np.empty((4, len(u)))
        self._columns[0] = 1.0
        self._columns[1] = u
        self._columns[2] = v
        self._columns[3] = squared / (1 + self._length)

    def fit(self, weights: Values | None = None) -> SphereCone | None:
        """Fit a cone by linear least squares.

        Args:
            weights: How much each ray counts, shape ``(n,)``; None for all alike.

        Returns:
            The cone; None where the rays do not say which.
        """
        weighted = self._columns if weights is None else self._columns * weights
        return self._cone((weighted @ self._columns.T).tolist())

    def misses_rad(self, cone: SphereCone) -> Values:
        """Return by what angle each ray passes outside the cone, negative inside, shape ``(n,)``.

        To first order, ``d · a - cos α`` divided by ``-sin α``.
        """
        cosine = math.sqrt(1 - cone.sine**2)
        m = [_dot(axis, cone.axis) for axis in self._basis]
        scale = -1.0 / cone.sine
        ahead = self._columns[1] * (m[1] * scale) + self._columns[2] * (m[2] * scale) + m[0] * scale
        return np.asarray(ahead / self._length - cosine * scale)

    def _cone(self, sums: list[list[float]]) -> SphereCone | None:
        """Solve the normal equations by Cramer's rule."""
        (a, b, c, r), (_, d, e, s), (_, _, f, t), _ = sums
        # Cofactors of the symmetric matrix.
        aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
        bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
        determinant = a * aa + b * ab + c * ac
        if not determinant > 0:
            return None
        q0 = (aa * r + ab * s + ac * t) / determinant
        q1 = (ab * r + bb * s + bc * t) / determinant
        q2 = (ac * r + bc * s + cc * t) / determinant
        excess = 2 * q0 + q0 * q0 + q1 * q1 + q2 * q2
        if not 0 < excess < math.inf:
            return None
        length = math.sqrt(1 + excess)
        g = 1 + q0
        # excess = tan² α, and a ray that errs by e moves the right side by e tan α.
        variance = aa * g * g + bb * q1 * q1 + cc * q2 * q2 + 2 * (ab * g * q1 + ac * g * q2 + bc * q1 * q2)
        ahead, across, down = self._basis
        x, y, z = ((g * i + q1 * j + q2 * k) / length for i, j, k in zip(ahead, across, down, strict=True))
        return SphereCone(
            axis=(x, y, z),
            sine=math.sqrt(excess) / length,
            sine_share=math.sqrt(max(variance / determinant, 0.0) / excess) / (1 + excess),
        )


def fit_cone(directions: Points, towards: tuple[float, float]) -> SphereCone | None:
    """Return the cone around a sphere from rays that touch it.

    Args:
        directions: Where the rays look to, x and y per unit of depth with the lens's distortion undone, shape
            ``(n, 2)``.
        towards: About where the centre is, x and y per unit of depth.

    Returns:
        The cone; None for fewer than `LEAST_RAYS` rays, or for rays that form none.
    """
    return ConeFrame(directions, towards).fit() if len(directions) >= LEAST_RAYS else None


def _basis(towards: tuple[float, float]) -> tuple[Vector, Vector, Vector]:
    """Return three vectors of length 1 at right angles, the first one along the guess."""
    x, y = towards
    length = math.sqrt(1 + x * x + y * y)
    a = (x / length, y / length, 1 / length)
    # Any two vectors across will do; this one is never short, since the guess looks forward.
    across = math.hypot(a[0], a[2])
    b = (a[2] / across, 0.0, -a[0] / across)
    c = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    return a, b, c


def _dot(one: Vector, other: Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
