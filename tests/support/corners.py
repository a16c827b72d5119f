"""What a detector says of something with four corners."""

from __future__ import annotations

from stadimeter.core.detection import Detection, DetectionStatus, Points
from stadimeter.detectors.sides import diagonals_meet, width_and_height


def detection_of_corners(corners_px: Points, sigma_px: float, target: str = "it") -> Detection:
    """Return the detection of something flat by its corners, in pixels and in the order of its outline."""
    width_px, height_px = width_and_height(corners_px)
    return Detection(
        target=target,
        status=DetectionStatus.FOUND,
        outline_px=corners_px,
        centre_px=diagonals_meet(corners_px),
        width_px=width_px,
        height_px=height_px,
        size_sigma_px=sigma_px,
    )
