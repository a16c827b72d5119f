"""Where a disc is, from the ellipse that it is seen as."""

from __future__ import annotations

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.core.target import DiscSize
from stadimeter.ranging.apparent_size import ApparentSize, apparent_size
from stadimeter.ranging.circle_pose import circle_poses, cone_through
from stadimeter.ranging.reading import Reading, size_noise_share
from stadimeter.ranging.similar_triangles import distance_m

NO_IDEA = 1.0
"""The ambiguity of every disc: its outline fits two mirrored poses equally well."""


def read_disc(detection: Detection, size: DiscSize, camera: CameraModel) -> Reading:
    """Return where a disc's centre is.

    Distance and tilt are exact at any tilt: they are the same in both poses of `stadimeter.ranging.circle_pose`, so not
    knowing which of them it is adds nothing to the uncertainty of the distance. The position is put half way between
    them, on the axis of the cone; their lines of sight are at most some degrees apart, near by and tilted, and much
    less from afar.

    Args:
        detection: A disc that was found whole, with points on its outline.
        size: Its size.
        camera: The camera model at the picture's resolution.

    Returns:
        The position and how sure it is.
    """
    known = apparent_size(detection, size, camera.fx_px, camera.fy_px)
    noise_share = size_noise_share(detection, camera, known.apparent)
    cone = cone_through(camera.directions(detection.outline_px))
    found = None if cone is None else circle_poses(cone, size.diameter_m)
    if found is None:
        return Reading(position_m=_by_larger_diameter(known, detection, camera), noise_share=noise_share)
    x_m, y_m, z_m = (float(each) * found.distance_m for each in found.axis)
    return Reading(position_m=(x_m, y_m, z_m), noise_share=noise_share, tilt_rad=found.tilt_rad, ambiguity=NO_IDEA)


def _by_larger_diameter(known: ApparentSize, detection: Detection, camera: CameraModel) -> tuple[float, float, float]:
    """Return the position by similar triangles, for a detector that gives no outline."""
    depth_m = distance_m(1.0, known.size_m, known.apparent)
    x, y = camera.direction(*detection.centre_px)
    return (x * depth_m, y * depth_m, depth_m)
