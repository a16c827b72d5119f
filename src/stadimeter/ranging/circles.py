"""Three equal discs at the corners of an equilateral triangle, and where that is from the ellipses they are seen as.

Blur, glare and sharpening make every disc seem larger or smaller, but leave its centre where it is. So the size that
counts is the triangle's, which is known; the discs' common diameter is fitted beside the pose. Three centres alone
allow several poses: the shapes and the relative sizes of the ellipses tell which one it is.

The triangle is the same whichever disc is called the first, so their order is not asked for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points, Reading, Values
from stadimeter.ranging.flat import FlatShape, circle_poses, cone_through
from stadimeter.ranging.similar_triangles import read_by_one_length

# Corners of the triangle about its centre, as shares of its side: the circumscribed circle has the radius 1 / √3.
_ANGLES = np.arange(3) * 2 * math.pi / 3
CORNERS = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES))) / math.sqrt(3)

# Gauss-Newton steps at most, and the step, as a share, that no longer matters; differences for derivatives.
MAX_STEPS = 12
SETTLED = 1e-8
DIFFERENCE = 1e-6

# The detector's standard deviation of the side, on sharp rendered pictures.
_SIGMA_FLOOR_PX = 0.005


class CirclesShape(FlatShape, Struct, frozen=True, kw_only=True):
    """Three equal discs whose centres are equally far apart."""

    diameter_m: float
    spacing_m: float  # from centre to centre
    relative_sigma: float = 0.0  # standard deviation of the spacing, as a share: how well it is known

    @property
    def label(self) -> str:
        """Kind, spacing and diameter."""
        return f"three circles of {self.diameter_m:g} m, {self.spacing_m:g} m apart"

    @property
    def longest_m(self) -> float:
        """The spacing, which is what is measured."""
        return self.spacing_m

    @property
    def shortest_m(self) -> float:
        """The diameter: each disc must be large enough to be found."""
        return self.diameter_m

    @property
    def has_corners(self) -> bool:
        """No: its outline is points on three rims."""
        return False

    def size_sigma_px(self, size_px: float) -> float:  # noqa: ARG002 - the same for all sizes
        """Return the standard deviation of the apparent diameter that stands for that of the spacing."""
        return _SIGMA_FLOOR_PX * self.diameter_m / self.spacing_m

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where the triangle's centre is; by its apparent side where there are no three ellipses."""
        apparent = max(detection.width_px / camera.fx_px, detection.height_px / camera.fy_px)
        count = len(detection.outline_px)
        rims = camera.directions(detection.outline_px).reshape(3, -1, 2) if count and count % 3 == 0 else None
        fitted = None if rims is None else _fit(rims, self.diameter_m / 2, self.spacing_m)
        if fitted is None:
            return read_by_one_length(detection, camera, self.spacing_m, apparent)
        # The side errs by √2 times what a coordinate of a centre does. A centre is as exact as the mean of n points
        # that err by √(n / 2) times as much each, and so is the fit through n points on each rim.
        point_sigma = detection.size_sigma_px / math.sqrt(2 * camera.fx_px * camera.fy_px) * math.sqrt(count / 6)
        x_m, y_m, z_m = fitted.centre_m.tolist()
        return Reading(
            position_m=(x_m, y_m, z_m),
            noise_share=point_sigma * fitted.share_of_noise,
            tilt_rad=fitted.tilt_rad,
            ambiguity=fitted.ambiguity,
        )


class _Pose(NamedTuple):
    turn: Values  # columns are the plane's axes in the camera frame, the normal last
    centre_m: Values
    radius_m: float

    def moved(self, step: Values) -> _Pose:
        """Return the pose turned about the camera's axes and shifted, lengths as shares of the distance."""
        turn = np.asarray(cv2.Rodrigues(step[:3])[0], np.float64) @ self.turn
        centre_m = self.centre_m + step[3:6] * float(np.linalg.norm(self.centre_m))
        return _Pose(turn, centre_m, self.radius_m * math.exp(float(step[6])))

    def mirrored(self) -> _Pose:
        """Return the pose turned as much towards the other side, which from afar looks nearly the same."""
        sight = self.centre_m / np.linalg.norm(self.centre_m)
        flip = np.eye(3) - 2 * np.outer(sight, sight)
        turn = flip @ self.turn
        return self._replace(turn=np.column_stack((turn[:, :2], -turn[:, 2])))

    def off(self, rims: Points, spacing_m: float) -> Values:
        """Measure how far rays, ``(3, n, 3)``, are outside of the ellipses as this pose has them, per unit of depth."""
        # A point X, Y of the plane is seen at H (X, Y, 1); a circle C of the plane as the conic H⁻ᵀ C H⁻¹.
        back = np.linalg.inv(np.column_stack((self.turn[:, :2], self.centre_m)))
        on_plane = rims @ back.T
        circles = np.zeros((3, 3, 3))
        corners_m = CORNERS * spacing_m
        circles[:, 0, 0] = circles[:, 1, 1] = 1.0
        circles[:, :2, 2] = circles[:, 2, :2] = -corners_m
        circles[:, 2, 2] = (corners_m**2).sum(axis=1) - self.radius_m**2
        polar = on_plane @ circles
        # The distance from a conic to first order (P. Sampson, 1982): its value over its gradient in the picture.
        gradient = 2 * polar @ back
        steepness = np.hypot(gradient[..., 0], gradient[..., 1])
        return np.asarray(((polar * on_plane).sum(axis=2) / np.maximum(steepness, 1e-300)).ravel())


class _Fitted(NamedTuple):
    centre_m: Values
    tilt_rad: float
    share_of_noise: float  # standard deviation of the distance, as a share, where each point errs by 1
    ambiguity: float


def _fit(directions: Points, radius_m: float, spacing_m: float) -> _Fitted | None:
    """Return the pose by least squares over all three rims, x and y per unit of depth, shape ``(3, n, 2)``."""
    rims = np.concatenate((directions, np.ones((*directions.shape[:2], 1))), axis=2)
    pose = _start(directions, radius_m)
    if pose is None:
        return None
    try:
        for _ in range(MAX_STEPS):
            off = pose.off(rims, spacing_m)
            slopes = [(pose.moved(d).off(rims, spacing_m) - off) / DIFFERENCE for d in np.eye(7) * DIFFERENCE]
            jacobian = np.stack(slopes, axis=1)
            covariance = np.linalg.inv(jacobian.T @ jacobian)
            step = -covariance @ (jacobian.T @ off)
            pose = pose.moved(step)
            if np.abs(step).max() < SETTLED:
                break
    except np.linalg.LinAlgError:
        return None
    if not (np.isfinite(pose.centre_m).all() and pose.centre_m[2] > 0):
        return None
    sight = pose.centre_m / np.linalg.norm(pose.centre_m)
    misfit, other = (float(np.linalg.norm(each.off(rims, spacing_m))) for each in (pose, pose.mirrored()))
    return _Fitted(
        centre_m=pose.centre_m,
        tilt_rad=math.acos(min(1.0, abs(float(pose.turn[:, 2] @ sight)))),
        share_of_noise=math.sqrt(max(float(sight @ covariance[3:6, 3:6] @ sight), 0.0)),
        ambiguity=min(1.0, misfit / other) if other > 0 else 1.0,
    )


def _start(directions: Points, radius_m: float) -> _Pose | None:
    """Return the plane through the places that the discs have by their own sizes; None if one is no ellipse."""
    places = []
    for rim in directions:
        cone = cone_through(rim)
        poses = None if cone is None else circle_poses(cone, 2 * radius_m)
        if poses is None:
            return None
        places.append(poses.axis * poses.distance_m)
    centre_m = np.mean(places, axis=0)
    right = (places[0] - centre_m) / max(float(np.linalg.norm(places[0] - centre_m)), 1e-300)
    normal = np.cross(places[1] - places[0], places[2] - places[0])
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    return _Pose(np.column_stack((right, np.cross(normal, right), normal)), centre_m, radius_m)
