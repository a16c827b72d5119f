"""Where a sheet is, from the side that is turned away the least."""

from __future__ import annotations

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.core.target import SheetSize
from stadimeter.ranging.apparent_size import apparent_size
from stadimeter.ranging.reading import Reading, size_noise_share
from stadimeter.ranging.similar_triangles import distance_m


def read_sheet(detection: Detection, size: SheetSize, camera: CameraModel) -> Reading:
    """Return where a sheet's centre is.

    Similar triangles are exact where the sheet faces the camera; turned away it appears shorter, and too far away.

    Args:
        detection: A sheet that was found whole.
        size: Its size.
        camera: The camera model at the picture's resolution.

    Returns:
        The position and how sure it is.
    """
    known = apparent_size(detection, size, camera.fx_px, camera.fy_px)
    depth_m = distance_m(1.0, known.size_m, known.apparent)
    x, y = camera.direction(*detection.centre_px)
    return Reading(
        position_m=(x * depth_m, y * depth_m, depth_m),
        noise_share=size_noise_share(detection, camera, known.apparent),
    )
