"""What one kind of target gives: where its centre is, and how sure that is."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Where a target's centre is.

    Attributes:
        position_m: In the camera frame: x to the right, y down, z along the optical axis.
        noise_share: Standard deviation of the distance that differs from frame to frame, as a share of the distance.
        systematic_share: The part that stays from frame to frame, without those of the focal length and of the size.
        tilt_rad: Of something flat, the angle between its normal and the line of sight, 0 for face on; None for a ball.
        ambiguity: Of something flat, how far it is from certain which of two mirrored poses it has: 0 for certain, 1
            for no idea; None for a ball.
    """

    position_m: tuple[float, float, float]
    noise_share: float
    systematic_share: float = 0.0
    tilt_rad: float | None = None
    ambiguity: float | None = None


def size_noise_share(detection: Detection, camera: CameraModel, apparent: float) -> float:
    """Return the standard deviation of the apparent size as a share of it.

    Args:
        detection: Holds the standard deviation in pixels.
        camera: The camera.
        apparent: The apparent size per unit of depth.

    Returns:
        The share.
    """
    return detection.size_sigma_px / math.sqrt(camera.fx_px * camera.fy_px) / apparent
