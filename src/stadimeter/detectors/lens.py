"""The lens of a frame."""

from __future__ import annotations

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError


def lens_for(camera: CameraModel | None, frame: Frame) -> CameraModel | None:
    """Return the camera model at a frame's resolution.

    Returns:
        The model; None if there is none, or if it is for pictures of another aspect: the target can be looked for all
        the same, and measuring it says what is wrong.
    """
    if camera is None:
        return None
    try:
        return camera.scaled_to(frame.width_px, frame.height_px)
    except CalibrationError:
        return None
