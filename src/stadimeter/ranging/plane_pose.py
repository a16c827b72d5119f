"""Where a flat rectangle is and how it is turned, from its four corners.

Both poses that a picture of a plane may have come out of `stadimeter.ranging.infinitesimal_pose`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.ranging.infinitesimal_pose import RectanglePose, misfit, rectangle_poses

SQUARE = np.array(((-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0)))
"""The corners of a square with a side of 1 in its own frame, x right, y up, from the top left one on."""

NO_BENDING = np.zeros(0)
IN_DIRECTIONS = np.eye(3)
"""The camera matrix where corners are given as directions instead of pixels."""

COORDINATES = 8
FREEDOM = 6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlanePose:
    """A pose of something flat.

    Attributes:
        position_m: Its centre in the camera frame, shape ``(3,)``: x right, y down, z forward.
        rotation: Its axes in the camera frame as columns, shape ``(3, 3)``: x towards its right, y towards its top.
        misfit: How far the corners appear from where the pose has them, root mean square of their coordinates, per
            unit of depth.
    """

    position_m: Points
    rotation: NDArray[np.float64]
    misfit: float

    @property
    def distance_m(self) -> float:
        """Length of the straight line from the camera to the centre."""
        return math.hypot(*self.position_m.tolist())

    @property
    def tilt_rad(self) -> float:
        """Angle between the normal and the line of sight, 0 for face on."""
        along_sight = float(self.rotation[:, 2] @ self.position_m) / self.distance_m
        return math.acos(min(abs(along_sight), 1.0))


def rectangle(width_m: float, height_m: float) -> Points:
    """Return the corners of a rectangle in its own frame, as `plane_poses` takes them, shape ``(4, 3)``."""
    return SQUARE * (width_m, height_m, 0.0)


def plane_poses(corners_m: Points, directions: Points) -> tuple[PlanePose, ...]:
    """Return the poses that a rectangle may have, the one that explains its corners best first.

    The better one is refined by least squares. The other one is not, since from near by that would lead to the better
    one too.

    Args:
        corners_m: Its corners in its own frame, as `rectangle` gives them, shape ``(4, 3)``.
        directions: Where they appear, x and y per unit of depth with the lens's distortion undone, in the same order,
            shape ``(4, 2)``.

    Returns:
        Two poses; fewer where the corners are not those of a rectangle in front of the camera.
    """
    half_width_m, half_height_m = float(corners_m[1, 0]), float(corners_m[0, 1])
    found = rectangle_poses(half_width_m, half_height_m, directions.tolist())
    poses = [_as_arrays(pose) for pose in found]
    return tuple(_refined(corners_m, directions, pose) for pose in poses[:1]) + tuple(poses[1:])


def ambiguity(poses: tuple[PlanePose, ...]) -> float:
    """Return how far it is from certain which of two poses it is.

    Args:
        poses: The poses, the best first.

    Returns:
        The best pose's misfit as a share of the other one's: 0 for certain, 1 for no idea.
    """
    if len(poses) < 2:
        return 0.0
    return poses[0].misfit / poses[1].misfit if poses[1].misfit > 0 else 1.0


def doubt_share(poses: tuple[PlanePose, ...], corner_sigma: float) -> float:
    """Return by how much the distance is unsure because the other poses may be the true ones.

    Args:
        poses: The poses, the best first; of two ways to hold a sheet, those of both.
        corner_sigma: Standard deviation of a corner's coordinates, per unit of depth.

    Returns:
        A standard deviation as a share of the best pose's distance.
    """
    best = poses[0]
    return sum(
        math.sqrt(_probability(other, best, corner_sigma)) * abs(other.distance_m / best.distance_m - 1)
        for other in poses[1:]
    )


def distance_share(pose: PlanePose, corners_m: Points, corner_sigma: float) -> float:
    """Return how unsure the distance is because corners are, by propagation through the pose's least squares fit.

    The inverse of the normal matrix is the covariance of the pose (R. Hartley and A. Zisserman, "Multiple View
    Geometry", section 5.2). Where the tilt is told badly, a sheet that faces the camera looks tilted, so nearer, by
    half the tilt's variance.

    Args:
        pose: The pose.
        corners_m: The corners in the thing's own frame, shape ``(4, 3)``.
        corner_sigma: Standard deviation of a corner's coordinates, per unit of depth.

    Returns:
        A standard deviation as a share of the distance; infinite where the corners do not tell the pose.
    """
    jacobian = _jacobian(pose, corners_m)
    try:
        covariance = np.linalg.inv(jacobian.T @ jacobian) * corner_sigma**2
    except np.linalg.LinAlgError:
        return math.inf
    outwards = pose.position_m / pose.distance_m
    of_distance = max(float(outwards @ covariance[3:, 3:] @ outwards), 0.0)
    of_turns = pose.rotation.T @ covariance[:3, :3] @ pose.rotation
    of_tilt = max(float(of_turns[0, 0]), float(of_turns[1, 1]))
    return math.hypot(math.sqrt(of_distance) / pose.distance_m, of_tilt / 2)


def _jacobian(pose: PlanePose, corners_m: Points) -> NDArray[np.float64]:
    """Return how the seen corners change with a small turn about the camera's axes and with a shift, ``(8, 6)``."""
    turned = corners_m @ pose.rotation.T
    placed = turned + pose.position_m
    jacobian = np.zeros((4, 2, FREEDOM))
    for axis in (0, 1):
        jacobian[:, axis, 3 + axis] = 1
        jacobian[:, axis, 5] = -placed[:, axis] / placed[:, 2]
    x, y, z = turned.T
    slope_x, slope_y = jacobian[:, 0, 5], jacobian[:, 1, 5]
    jacobian[:, 0, :3] = np.column_stack((slope_x * y, z - slope_x * x, -y))
    jacobian[:, 1, :3] = np.column_stack((slope_y * y - z, -slope_y * x, x))
    return np.asarray((jacobian / placed[:, 2][:, None, None]).reshape(COORDINATES, FREEDOM))


def _as_arrays(pose: RectanglePose) -> PlanePose:
    (a, b, c), (d, e, f) = pose.right, pose.up
    normal = (b * f - c * e, c * d - a * f, a * e - b * d)
    rotation = np.array((pose.right, pose.up, normal)).T
    return PlanePose(position_m=np.array(pose.position_m), rotation=rotation, misfit=pose.misfit)


def _refined(corners_m: Points, seen: Points, pose: PlanePose) -> PlanePose:
    """Return the pose nearby whose corners appear nearest to where they were seen."""
    first_turn, first_shift = cv2.Rodrigues(pose.rotation)[0], pose.position_m.reshape(3, 1).copy()
    try:
        turn, shift = cv2.solvePnPRefineLM(
            corners_m, seen.reshape(4, 1, 2), IN_DIRECTIONS, NO_BENDING, first_turn, first_shift
        )
    except cv2.error:
        return pose
    rotation, position = np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(shift, np.float64).reshape(3)
    right, up, _ = rotation.T.tolist()
    missed = misfit(right, up, position.tolist(), corners_m.tolist(), seen.tolist())
    return PlanePose(position_m=position, rotation=rotation, misfit=missed) if missed <= pose.misfit else pose


def _probability(other: PlanePose, best: PlanePose, corner_sigma: float) -> float:
    """Return how probable the other pose is, if corners err normally: 1/2 at most."""
    worse = max(other.misfit**2 - best.misfit**2, 0.0) * COORDINATES / max(corner_sigma, 1e-12) ** 2
    return 1 / (1 + math.exp(min(worse / 2, 700.0)))
