"""Where a tag is, from the pose of its four corners."""

from __future__ import annotations

import math

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points
from stadimeter.core.target import TagSize
from stadimeter.ranging.apparent_size import ApparentSize
from stadimeter.ranging.plane_pose import PlanePose, ambiguity, doubt_share, plane_poses, rectangle
from stadimeter.ranging.reading import Reading, size_noise_share
from stadimeter.ranging.similar_triangles import distance_m


def read_tag(detection: Detection, size: TagSize, camera: CameraModel) -> Reading:
    """Return where a tag's centre is.

    Seen from far, a tag has two poses that explain its corners nearly equally well, mirrored about the line of sight.
    Their distances and directions hardly differ; how much they do counts in the systematic share, the more so the less
    is known which of them it is.

    Args:
        detection: A tag that was found whole.
        size: Its size.
        camera: The camera model at the picture's resolution.

    Returns:
        The position and how sure it is.
    """
    known = _mean_side(detection, size, camera)
    noise_share = size_noise_share(detection, camera, known.apparent)
    poses = tag_poses(camera.directions(detection.outline_px), size) if len(detection.outline_px) == 4 else ()
    if not poses:
        return Reading(position_m=_by_mean_side(known, detection, camera), noise_share=noise_share)
    x_m, y_m, z_m = poses[0].position_m.tolist()
    corner_sigma = noise_share * known.apparent / math.sqrt(2)
    return Reading(
        position_m=(x_m, y_m, z_m),
        noise_share=noise_share,
        systematic_share=doubt_share(poses, corner_sigma),
        tilt_rad=poses[0].tilt_rad,
        ambiguity=ambiguity(poses),
    )


def tag_poses(directions: Points, size: TagSize) -> tuple[PlanePose, ...]:
    """Return the poses that a tag may have, the one that explains its corners best first.

    Args:
        directions: Where its corners appear, x and y per unit of depth with the lens's distortion undone, clockwise in
            the picture from its own top left one, shape ``(4, 2)``.
        size: Its size.

    Returns:
        Two poses; fewer where the corners are not those of a square in front of the camera.
    """
    return plane_poses(rectangle(size.side_m, size.side_m), directions)


def _mean_side(detection: Detection, size: TagSize, camera: CameraModel) -> ApparentSize:
    """Return the side as long as its four pictures are on average: turned, a tag is measured less well."""
    apparent = (detection.width_px / camera.fx_px + detection.height_px / camera.fy_px) / 2
    return ApparentSize(size_m=size.side_m, apparent=apparent, name="side")


def _by_mean_side(known: ApparentSize, detection: Detection, camera: CameraModel) -> tuple[float, float, float]:
    """Return the position by similar triangles, for a detector that gives no corners."""
    depth_m = distance_m(1.0, known.size_m, known.apparent)
    x, y = camera.direction(*detection.centre_px)
    return (x * depth_m, y * depth_m, depth_m)
