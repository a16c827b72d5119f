"""Pictures to measure a computer's speed on: a simulated room with a ball, or with a flat target put into it."""

from __future__ import annotations

from collections.abc import Sequence

import cv2

from stadimeter.app.clock import SteppedClock
from stadimeter.config.plugins import CAMERAS, WORLDS, DriverContext, Shared, load_plugin
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image

FIELD_OF_VIEW_FACTOR = 0.94
"""Focal length divided by width: about 56° wide, as most cameras are."""
PICTURES = 6

_PATH_S = 5
_PATH = [
    {"at": "0 s", "x": "1.2 m", "y": "0.2 m"},
    {"at": "5 s", "x": "2.5 m", "y": "-0.4 m"},
    {"at": "10 s", "x": "1.2 m", "y": "0.2 m"},
]


def lens_for(width_px: int, height_px: int) -> CameraModel:
    """Return a camera model for a size of pictures."""
    return CameraModel.with_focal_length(FIELD_OF_VIEW_FACTOR * width_px, width_px, height_px)


def room_frames(lens: CameraModel, count: int = PICTURES) -> list[Frame]:
    """Draw pictures of the simulated room, in which a ball of 20 cm moves, as that camera sees it."""
    context = DriverContext(name="bench", clock=SteppedClock(), camera_model=lens, shared=Shared())
    world, camera = load_plugin(WORLDS, "simulated"), load_plugin(CAMERAS, "simulated")
    options = {"ball_diameter": "20 cm", "camera_height": "12 cm", "path": _PATH}
    world.build(world.options.model_validate(options), context)
    built = camera.build(camera.options.model_validate({"rate": f"{count / _PATH_S} Hz"}), context)
    built.open()
    try:
        return [built.read() for _ in range(count)]
    finally:
        built.close()


def with_patch(frames: Sequence[Frame], patch: Image) -> list[Frame]:
    """Put a flat target into pictures, each time somewhere else.

    Args:
        frames: The pictures, which are not changed.
        patch: The target, as it looks in a picture 480 px high.
    """
    return [
        Frame(_pasted(frame.image, patch, (number + 1) / (len(frames) + 1)), frame.captured_at_s, frame.sequence)
        for number, frame in enumerate(frames)
    ]


def _pasted(image: Image, patch: Image, share: float) -> Image:
    scale = image.shape[0] / 480
    scaled = cv2.resize(
        patch, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    )
    height, width = scaled.shape[:2]
    left, top = round(share * (image.shape[1] - width)), round(0.4 * (image.shape[0] - height))
    changed = image.copy()
    changed[top : top + height, left : left + width] = scaled
    changed.flags.writeable = False
    return changed
