"""Height of a camera above the floor and its tilt, from a rectangle of known sides that lies on it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points
from stadimeter.errors import CalibrationError
from stadimeter.ranging.flat import SheetShape, TagShape
from stadimeter.ranging.floor import through_other_lenses
from stadimeter.ranging.plane_pose import COORDINATES, PlanePose, RectanglePose, plane_poses, rectangle, refine

# The other pose that explains the corners must be this much worse, as a chi-square: once in 10,000 it is the true one.
CLEARLY_WORSE = 18.0

# Corners are off by this, in pixels, besides what the detector states: paper does not lie quite flat.
NOT_FLAT_PX = 0.1


class CameraAboveFloor(Struct, frozen=True, kw_only=True):
    """The place of a camera above the floor, with the standard deviations of its height and tilt.

    Attributes:
        tilt_rad: How far it looks up from level.
        roll_rad: How far its right side is down.
    """

    height_m: float
    height_sigma_m: float
    tilt_rad: float
    tilt_sigma_rad: float
    roll_rad: float


def camera_above(found: Detection, shape: SheetShape | TagShape, camera: CameraModel) -> CameraAboveFloor:
    """Return where the camera is, from one picture of a sheet or a tag that lies on the floor.

    The normal n of the plane is the vertical, and its centre p lies ``h = -n · p`` below the camera, which looks up by
    ``asin n_z``. Each cause, the coordinates of the corners, the lens and the size, is moved by one standard deviation.

    Args:
        camera: The camera model at the picture's resolution.

    Raises:
        CalibrationError: The corners may be seen from two sides, or are not those of the rectangle.
    """
    corners = np.asarray(found.outline_px, dtype=np.float64)
    focal_px = math.sqrt(camera.fx_px * camera.fy_px)
    sigma = math.hypot(found.size_sigma_px / math.sqrt(2), NOT_FLAT_PX) / focal_px
    seen = camera.directions(corners)
    pose, corners_m = _pose(seen, shape, sigma)
    height_m, tilt_rad, roll_rad = _above(pose)
    moved = [seen + step.reshape(4, 2) for step in np.eye(COORDINATES) * sigma]
    moved += [rays for rays, _ in through_other_lenses(seen, camera)]
    poses = [refine(pose, corners_m, each.tolist()) for each in moved]
    changes = np.array([_above(each) for each in poses]) - (height_m, tilt_rad, roll_rad)
    off_m, off_rad, _ = np.sqrt((changes**2).sum(axis=0)).tolist()
    return CameraAboveFloor(
        height_m=height_m,
        height_sigma_m=math.hypot(off_m, height_m * shape.relative_sigma),
        tilt_rad=tilt_rad,
        tilt_sigma_rad=off_rad,
        roll_rad=roll_rad,
    )


def mean_of(views: Sequence[CameraAboveFloor]) -> CameraAboveFloor:
    """Return the mean of several pictures. Their ± is that of the best one, and how far they differ.

    Errors of the lens and of the size are the same in all of them, so more pictures do not make these smaller.
    """
    count, best = len(views), min(views, key=lambda each: each.tilt_sigma_rad)
    heights, tilts = [each.height_m for each in views], [each.tilt_rad for each in views]
    spreads = [float(np.std(each, ddof=1)) / math.sqrt(count) if count > 1 else 0.0 for each in (heights, tilts)]
    return CameraAboveFloor(
        height_m=sum(heights) / count,
        height_sigma_m=math.hypot(best.height_sigma_m, spreads[0]),
        tilt_rad=sum(tilts) / count,
        tilt_sigma_rad=math.hypot(best.tilt_sigma_rad, spreads[1]),
        roll_rad=sum(each.roll_rad for each in views) / count,
    )


def _pose(seen: Points, shape: SheetShape | TagShape, sigma: float) -> tuple[PlanePose, list[list[float]]]:
    """Return the pose that explains the corners, and these in its own frame; a sheet may lie along or across."""
    sides = (shape.longest_m, shape.shortest_m)
    known: list[tuple[RectanglePose, Points]] = []
    for width_m, height_m in dict.fromkeys((sides, sides[::-1])):
        corners_m = rectangle(width_m, height_m)
        known += [(pose, corners_m) for pose in plane_poses(corners_m, seen)]
    known.sort(key=lambda each: each[0].misfit)
    if not known:
        raise CalibrationError("its corners are not those of a rectangle that lies before the camera")
    best, corners_m = known[0]
    # Half a turn about the normal is the same pose, and a square has four of them.
    others = [pose for pose, _ in known[1:] if math.dist(pose.normal, best.normal) > 1e-3]
    if any((other.misfit**2 - best.misfit**2) * COORDINATES < CLEARLY_WORSE * sigma**2 for other in others):
        raise CalibrationError("it is seen too small to tell how it lies; put it nearer, or take a larger one")
    return PlanePose(*best[:3]), corners_m.tolist()


def _above(pose: PlanePose) -> tuple[float, float, float]:
    """Return height, tilt and roll: the normal of what lies on the floor is up, (0, -cos t, sin t) without a roll."""
    x, y, z = RectanglePose(*pose, 0.0).normal
    height_m = -(x * pose.position_m[0] + y * pose.position_m[1] + z * pose.position_m[2])
    return height_m, math.asin(min(max(z, -1.0), 1.0)), math.atan2(-x, -y)
