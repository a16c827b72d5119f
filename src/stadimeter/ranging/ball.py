"""The shape of a ball, and where one is, from the cone of rays that touch it.

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

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points, Reading, Values
from stadimeter.ranging.similar_triangles import size_noise_share

Vector = tuple[float, float, float]

# Square of the tangent of the half angle beyond which rays form no cone around a sphere: it would fill 168 degrees.
MAX_EXCESS = 100.0

# Fewer rays say too little about three unknowns.
MIN_RAYS = 6


class SphereCone(Struct, frozen=True, kw_only=True, eq=False):
    """The cone around a sphere. The camera frame is x right, y down, z forward."""

    axis: Vector  # unit vector towards the centre, in the camera frame
    sine: float  # sine of the half angle: the sphere's radius as a share of its distance
    # Standard deviation of `sine` as a share of it, for rays that err independently by one radian: to be
    # multiplied by how much they do err.
    sine_share: float

    def distance_m(self, radius_m: float) -> float:
        """Return the distance of the centre of a sphere of a radius."""
        return radius_m / self.sine

    @property
    def half_across(self) -> float:
        """The smaller half axis of the outline, per unit of focal length: ``sin α / sqrt(cos² θ - sin² α)``.

        θ is the angle between the cone's and the optical axis. Infinite for a sphere that reaches beside the camera.
        """
        # cos² θ - sin² α: zero where the cone touches the plane beside the camera, and the outline is a parabola.
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
    """Rays as seen along a first guess of the axis, x and y per unit of depth, ready to be fitted.

    They look to x and y per unit of depth, and ones, shape ``(3, n)``; or with a camera whose lens bends no lines, to x
    and y in pixels, and ones.
    """

    def __init__(self, rays: Values, towards: tuple[float, float], camera: CameraModel | None = None) -> None:
        self._basis = _basis(towards)
        axes = self._basis if camera is None else tuple(_on_pixels(axis, camera) for axis in self._basis)
        along = np.array(axes).dot(rays)
        # Rows 1, u, v and the right side: one product with its transpose holds all sums of the normal equations.
        self._rows = np.empty((4, rays.shape[1]))
        self._rows[0] = 1.0
        across = np.divide(along[1:], along[0], out=self._rows[1:3])
        squares = across * across
        # √(1 + s) - 1 written as s / (√(1 + s) + 1): no digits are lost for a small ball, where s is 1e-6.
        squared = squares[0] + squares[1]
        np.divide(squared, np.sqrt(squared + 1) + 1, out=self._rows[3])

    def fit(self, weights: Values | None = None) -> SphereCone | None:
        """Fit a cone by linear least squares, with weights, ``(n,)``, or none; None where the rays do not say which."""
        weighted = self._rows if weights is None else self._rows * weights
        return self._cone(weighted.dot(self._rows.T).tolist())

    def misses(self, cone: SphereCone, scale: float = 1.0) -> Values:
        """Return by what angle times the scale each ray passes outside the cone, negative inside, shape ``(n,)``.

        To first order that is ``cos α - d · a`` divided by ``sin α``, and that is ``cos α (1 - d · m)``. How far ``d ·
        m`` is from 1 is what the two sides of the last equation in the head of this file differ by, divided by the root
        in it, which is ``1 / cos α`` near the limb.
        """
        squared = 1 - cone.sine**2
        cosine, factor = math.sqrt(squared), scale * squared / cone.sine
        ahead, across, down = self._basis
        # One row of four factors for the rows 1, u, v and the right side: the misses of all rays are one product.
        g, back = _dot(ahead, cone.axis) / cosine, -factor / cosine
        terms = np.array(((1 - g) * factor, _dot(across, cone.axis) * back, _dot(down, cone.axis) * back, factor))
        return np.asarray(terms.dot(self._rows))

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
        if not 0 < excess < MAX_EXCESS:
            return None
        # |m| = 1 / cos α; sin α = √(|m|² - 1) / |m|.
        length = math.sqrt(1 + excess)
        g = 1 + q0
        # excess = tan² α, and a ray that errs by e moves the right side by e tan α.
        variance = aa * g * g + bb * q1 * q1 + cc * q2 * q2 + 2 * (ab * g * q1 + ac * g * q2 + bc * q1 * q2)
        ahead, across, down = self._basis
        g, q1, q2 = g / length, q1 / length, q2 / length
        return SphereCone(
            axis=(
                g * ahead[0] + q1 * across[0] + q2 * down[0],
                g * ahead[1] + q1 * across[1] + q2 * down[1],
                g * ahead[2] + q1 * across[2] + q2 * down[2],
            ),
            sine=math.sqrt(excess) / length,
            sine_share=math.sqrt(max(variance / determinant, 0.0) / excess) / (1 + excess),
        )


def fit_cone(directions: Points, towards: tuple[float, float]) -> SphereCone | None:
    """Return the cone around a sphere from rays that touch it; None for fewer than `MIN_RAYS`, or if they form none.

    Rays and the guess of the centre, `towards`, are x and y per unit of depth with the lens's distortion undone.
    """
    return ConeFrame(with_ones(directions), towards).fit() if len(directions) >= MIN_RAYS else None


def with_ones(directions: Points) -> Values:
    """Return directions as rays: x and y in a row each, shape ``(2, n)``, and a row of ones below."""
    rays = np.ones((3, len(directions)))
    rays[:2] = directions.T
    return rays


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


def _on_pixels(axis: Vector, camera: CameraModel) -> Vector:
    """Return by what pixels, as x, y and 1, are multiplied to have how far their rays reach along an axis."""
    x, y, z = axis[0] / camera.fx_px, axis[1] / camera.fy_px, axis[2]
    return x, y, z - x * camera.cx_px - y * camera.cy_px


def _dot(one: Vector, other: Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


# The detector's standard deviation on rendered pictures: a floor, and a part inverse to the apparent radius.
_SIGMA_FLOOR_PX = 0.05
_SIGMA_OF_SMALL_PX2 = 0.85


class BallShape(Struct, frozen=True, kw_only=True):
    """A sphere."""

    diameter_m: float
    relative_sigma: float = 0.0  # standard deviation of the diameter, as a share: how well it is known

    @property
    def label(self) -> str:
        """Kind and diameter."""
        return f"ball of {self.diameter_m:g} m"

    @property
    def longest_m(self) -> float:
        """The diameter."""
        return self.diameter_m

    @property
    def shortest_m(self) -> float:
        """The diameter."""
        return self.diameter_m

    @property
    def limb_radius_m(self) -> float:
        """The radius."""
        return self.diameter_m / 2

    @property
    def has_corners(self) -> bool:
        """No: its outline is points on its limb."""
        return False

    def size_sigma_px(self, size_px: float) -> float:
        """Return the standard deviation of the apparent diameter in a good picture."""
        return math.hypot(_SIGMA_FLOOR_PX, _SIGMA_OF_SMALL_PX2 / (size_px / 2))

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where the centre is: exactly, by the points on the limb, or by the diameter if there are none.

        A detector that measured with this very lens has fitted the cone already, with outliers left out: then its
        diameter and centre say all that the points do, and fitting them again would let the outliers in.
        """
        # For each axis of the picture its own focal length; of the two diameters the mean.
        apparent = (detection.width_px / camera.fx_px + detection.height_px / camera.fy_px) / 2
        noise_share = size_noise_share(detection, camera, apparent)
        centre = camera.direction(*detection.centre_px)
        cone, lens = None, detection.measured_with
        # Mostly it is the same object, which takes no look at what is in it.
        if lens is not camera and lens != camera and len(detection.outline_px):
            cone = fit_cone(camera.directions(detection.outline_px), centre)
        if cone is None:
            depth_m = self._depth_m(apparent)
            x, y = _direction(apparent, centre)
            return Reading(position_m=(x * depth_m, y * depth_m, depth_m), noise_share=noise_share)
        straight_m = cone.distance_m(self.diameter_m / 2)
        x, y, z = cone.axis
        return Reading(position_m=(x * straight_m, y * straight_m, z * straight_m), noise_share=noise_share)

    def _depth_m(self, apparent: float) -> float:
        """Return the depth of the centre, from the smaller diameter of the outline.

        The rays that graze a ball touch it nearer than its centre, so plain similar triangles read too near, by 0.5 %
        at five diameters and 5.7 % at one and a half. With P the smaller diameter of the elliptical outline, wherever
        in the picture it lies, ``Z² = (W F / P)² + (W / 2)²`` is exact: the cone of half angle α about an axis at θ to
        the optical axis cuts the picture in an ellipse of the smaller half axis ``b = sin α / sqrt(cos² θ - sin² α)``
        (for F = 1), and ``sin α = W / 2 D``, ``Z = D cos θ``.
        """
        # `apparent` is P / F, so the first term is W F / P. Plain similar triangles read a tennis ball at 1 m too near:
        # by 0.06 % on the axis, and by 13.5 % at 30 degrees off it if the larger axis of the outline is taken.
        return math.hypot(self.diameter_m / apparent, self.diameter_m / 2)


def _direction(apparent: float, centre: tuple[float, float]) -> tuple[float, float]:
    """Return the direction of a ball's centre, x and y per unit of depth, from that of the centre of its outline.

    The centre of the elliptical outline lies further out than the ball's, by the factor ``1 + b²`` with b as in
    `BallShape._depth_m`.
    """
    nearer = 1 + (apparent / 2) ** 2
    return centre[0] / nearer, centre[1] / nearer
