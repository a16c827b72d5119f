"""Similar triangles: the whole of pinhole ranging in one formula.

An object of width W at the distance D from a pinhole, square to the optical axis, appears P pixels wide at a focal
length of F pixels, with ``P / F = W / D``: the triangle before the pinhole and the one behind it are similar. A
textbook rule (R. Szeliski, Computer Vision: Algorithms and Applications, 2nd edition, section 2.1.4).

D is the depth: the distance along the optical axis.
"""

from __future__ import annotations

import math

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.core.target import Reading


def distance_m(focal_px: float, size_m: float, apparent_px: float) -> float:
    """Return the distance D = W · F / P, as a depth, of an object as large as W that appears as large as P.

    Raises:
        ValueError: A value is not a finite number above zero.
    """
    for name, value in (("focal_px", focal_px), ("size_m", size_m), ("apparent_px", apparent_px)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} is not a finite number above zero")
    return size_m * focal_px / apparent_px


def size_noise_share(detection: Detection, camera: CameraModel, apparent: float) -> float:
    """Return the standard deviation of an apparent size, given per unit of depth, as a share of it."""
    # σ in pixels over the focal length (geometric mean of both axes) is per unit of depth, like the apparent size.
    return detection.size_sigma_px / math.sqrt(camera.fx_px * camera.fy_px) / apparent


def read_by_one_length(detection: Detection, camera: CameraModel, size_m: float, apparent: float) -> Reading:
    """Return where a target is by one length, as if that were square to the optical axis and its centre in its middle.

    Its apparent length is per unit of depth.
    """
    depth_m = distance_m(1.0, size_m, apparent)
    x, y = camera.direction(*detection.centre_px)
    return Reading(
        position_m=(x * depth_m, y * depth_m, depth_m), noise_share=size_noise_share(detection, camera, apparent)
    )
