"""What the standard deviation of a distance is made up of."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.measurement import Measurement
from stadimeter.core.target import TargetSize


@dataclass(frozen=True, slots=True, kw_only=True)
class SigmaParts:
    """The causes of a distance's standard deviation. Their squares add up to its square.

    Attributes:
        edges_m: The noise of the edges in the picture, which differs from frame to frame.
        focal_length_m: How well the focal length is known.
        size_m: How well the target's size is known.
        pose_m: Everything else that stays; of something flat, which of two mirrored poses it has.
    """

    edges_m: float
    focal_length_m: float
    size_m: float
    pose_m: float


def sigma_parts(measured: Measurement, size: TargetSize, camera: CameraModel) -> SigmaParts | None:
    """Say what the standard deviation of a distance is made up of.

    Args:
        measured: The measurement.
        size: The target's size, as it was measured with.
        camera: The camera model that it was measured with.

    Returns:
        The parts; None if there is no distance.
    """
    if measured.distance_m is None or measured.sigma_m is None or measured.noise_m is None:
        return None
    focal_length_m = measured.distance_m * camera.focal_relative_sigma
    size_m = measured.distance_m * size.relative_sigma
    known_m = math.hypot(measured.noise_m, focal_length_m, size_m)
    # What is left of two nearly equal numbers is rounding error, no cause.
    rest_m2 = measured.sigma_m**2 - known_m**2
    return SigmaParts(
        edges_m=measured.noise_m,
        focal_length_m=focal_length_m,
        size_m=size_m,
        pose_m=math.sqrt(rest_m2) if rest_m2 > 1e-9 * measured.sigma_m**2 else 0.0,
    )
