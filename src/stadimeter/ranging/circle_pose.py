"""The place of a circle of known size, from the ellipse that it is seen as.

The rays to the rim of a circle form an elliptical cone ``d' Q d = 0``. A circle of that size cuts out of the cone in
two ways, mirrored about the cone's axis (R. Safaee-Rad et al., "Three-dimensional location estimation of circular
features for machine vision", IEEE Transactions on Robotics and Automation 8, 1992; Q. Chen, H. Wu and T. Wada, "Camera
calibration with two arbitrary coplanar circles", ECCV 2004).

With λ₁ ≥ λ₂ > 0 > λ₃ the eigenvalues of Q, and x and z along the eigenvectors of λ₁ and λ₃, the plane's normal is
``(± sqrt((λ₁ - λ₂) / (λ₁ - λ₃)), 0, sqrt((λ₂ - λ₃) / (λ₁ - λ₃)))``, and the centre of a circle of radius r is at
``Q⁻¹ n`` times ``-r sqrt(-λ₁ λ₃)``: the centre of the ellipse is not the picture of the circle's centre. Being mirrored
about the cone's axis, both poses have the same distance and are turned away from their line of sight by the same angle.
Written with the tangents a ≥ b of the cone's half angles, the distance is ``r sqrt(1 + (1 - b²) / a²)``: from far away
the larger one alone determines it.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Points, Values

# An ellipse has five unknowns.
MIN_POINTS = 5


class CirclePose(Struct, frozen=True, kw_only=True, eq=False):
    """A pose of a circle, in the camera frame: x right, y down, z forward."""

    position_m: Points  # its centre, shape ``(3,)``
    normal: Points  # the unit vector at right angles to its plane, towards the camera, shape ``(3,)``

    @property
    def distance_m(self) -> float:
        """Length of the straight line from the camera to the centre."""
        return float(np.linalg.norm(self.position_m))

    @property
    def tilt_rad(self) -> float:
        """Angle between the normal and the line of sight: 0 for face on."""
        return math.acos(min(1.0, -float(self.normal @ self.position_m) / self.distance_m))


class CirclePoses(Struct, frozen=True, kw_only=True, eq=False):
    """Both poses that an outline allows."""

    poses: tuple[CirclePose, CirclePose]  # they explain the outline equally well
    axis: Points  # the axis of the cone, half way between their lines of sight, as a unit vector of shape ``(3,)``

    @property
    def distance_m(self) -> float:
        """The distance of the centre, the same in both poses."""
        return self.poses[0].distance_m

    @property
    def tilt_rad(self) -> float:
        """The angle between normal and line of sight, the same in both poses."""
        return self.poses[0].tilt_rad


def cone_through(directions: Points) -> Values | None:
    """Return Q of the elliptical cone ``d' Q d = 0`` through rays, by linear least squares, positive outside.

    None if they are on no such cone. The rays are x and y per unit of depth, ``(n, 2)``, and should lie all around it.
    """
    if len(directions) < MIN_POINTS or not np.isfinite(directions).all():
        return None
    # Centred and of unit size: the five unknowns are of one magnitude, and the normal equations well conditioned.
    middle = directions.mean(axis=0)
    size = math.sqrt(float(np.mean((directions - middle) ** 2)))
    if not size > 0:
        return None
    # a x² + b x y + c y² + d x + e y = 1 for all rays: five unknowns, and the algebraic distance is close to the
    # geometric one for points all around the outline.
    x, y = ((directions - middle) / size).T
    rows = np.column_stack((x * x, x * y, y * y, x, y))
    try:
        a, b, c, d, e = np.linalg.solve(rows.T @ rows, rows.sum(axis=0))
    except np.linalg.LinAlgError:
        return None
    # The constant term is fixed at -1, so the centre is inside; of all conics only an ellipse has b² < 4 a c.
    if not (a > 0 and 4 * a * c > b * b):
        return None
    # Back from the centred coordinates: with d = T d₀ the cone d₀' Q d₀ = 0 becomes d' (T' Q T) d = 0.
    conic = np.array(((a, b / 2, d / 2), (b / 2, c, e / 2), (d / 2, e / 2, -1.0)))
    to_unit = np.array(((1 / size, 0.0, -middle[0] / size), (0.0, 1 / size, -middle[1] / size), (0.0, 0.0, 1.0)))
    return np.asarray(to_unit.T @ conic @ to_unit)


def circle_poses(cone: Values, diameter_m: float) -> CirclePoses | None:
    """Return the two poses of a circle in front of the camera that is seen on a cone; None if that is not elliptic."""
    # Eigenvalues come in rising order, λ₃ < λ₂ ≤ λ₁. The axis of the cone belongs to λ₃, the only one below zero.
    (third, second, first), axes = np.linalg.eigh(cone)
    if not third < 0 < second:
        return None
    # An eigenvector may point either way; the circle is before the camera.
    forward = axes[:, 0] if axes[2, 0] > 0 else -axes[:, 0]
    sideways = axes[:, 2]
    # Parts of the unit normal along the cone's axis and across it, towards the eigenvector of λ₁.
    along, across = math.sqrt((second - third) / (first - third)), math.sqrt((first - second) / (first - third))
    radius_m, steep = diameter_m / 2, math.sqrt(-first / third)
    # Mirrored about the axis: the part along it is the same, the part along λ₁'s eigenvector changes its sign.
    one, other = (
        CirclePose(
            position_m=radius_m * (steep * along * forward + sign / steep * across * sideways),
            normal=sign * across * sideways - along * forward,
        )
        for sign in (1, -1)
    )
    return CirclePoses(poses=(one, other), axis=forward)
