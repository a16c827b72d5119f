"""Where a sheet is, from the pose of its four corners, or from the one side that is named."""

from __future__ import annotations

import math

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points
from stadimeter.core.target import SheetSize
from stadimeter.ranging.apparent_size import ApparentSize, apparent_size
from stadimeter.ranging.plane_pose import PlanePose, ambiguity, distance_share, doubt_share, plane_poses, rectangle
from stadimeter.ranging.reading import Reading, size_noise_share
from stadimeter.ranging.similar_triangles import distance_m

CLOSER = 1e-9
"""Poses are ordered by misfit; of two that fit to rounding, the one as the sheet hangs comes first."""


def read_sheet(detection: Detection, size: SheetSize, camera: CameraModel) -> Reading:
    """Return where a sheet's centre is.

    Four corners tell how a sheet is turned, so its distance is right at any tilt. It may hang upright or across; both
    are tried, and the one that explains the corners better is taken. How probable the others are counts in the
    systematic share.

    With `SheetSize.known_side` named, that side alone decides, as if it were square to the line of sight: the other one
    may be unknown, or curled. So it is without corners.

    Args:
        detection: A sheet that was found whole.
        size: Its size.
        camera: The camera model at the picture's resolution.

    Returns:
        The position and how sure it is.
    """
    known = apparent_size(detection, size, camera.fx_px, camera.fy_px)
    if size.known_side != "auto" or len(detection.outline_px) != 4:
        return _by_one_side(known, detection, camera)
    poses = sheet_poses(camera.directions(detection.outline_px), size)
    if not poses:
        return _by_one_side(known, detection, camera)
    corner_sigma = detection.size_sigma_px / math.sqrt(2 * camera.fx_px * camera.fy_px)
    best, corners_m = poses[0]
    all_poses = tuple(pose for pose, _ in poses)
    x_m, y_m, z_m = best.position_m.tolist()
    noise_share = distance_share(best, corners_m, corner_sigma)
    return Reading(
        position_m=(x_m, y_m, z_m),
        noise_share=noise_share if math.isfinite(noise_share) else size_noise_share(detection, camera, known.apparent),
        systematic_share=doubt_share(all_poses, corner_sigma),
        tilt_rad=best.tilt_rad,
        ambiguity=ambiguity(all_poses[:2]),
    )


def sheet_poses(directions: Points, size: SheetSize) -> tuple[tuple[PlanePose, Points], ...]:
    """Return the poses that a sheet may have, with its width across the picture or down it.

    Args:
        directions: Where its corners appear, x and y per unit of depth with the lens's distortion undone, clockwise in
            the picture, shape ``(4, 2)``.
        size: Its size.

    Returns:
        Poses, and the corners in the sheet's frame that belong to them, shape ``(4, 3)``; the pose that explains the
        corners best comes first. None where the corners are not those of a rectangle in front of the camera.
    """
    found = []
    for width_m, height_m in dict.fromkeys(((size.width_m, size.height_m), (size.height_m, size.width_m))):
        corners_m = rectangle(width_m, height_m)
        found += [(pose, corners_m) for pose in plane_poses(corners_m, directions)]
    found.sort(key=lambda each: round(each[0].misfit / CLOSER))
    return tuple(found)


def _by_one_side(known: ApparentSize, detection: Detection, camera: CameraModel) -> Reading:
    """Return the position by similar triangles: exact for a side that is square to the line of sight."""
    depth_m = distance_m(1.0, known.size_m, known.apparent)
    x, y = camera.direction(*detection.centre_px)
    return Reading(
        position_m=(x * depth_m, y * depth_m, depth_m),
        noise_share=size_noise_share(detection, camera, known.apparent),
    )
