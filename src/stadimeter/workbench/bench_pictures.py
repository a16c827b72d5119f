"""Pictures to measure a computer's speed on: a simulated room with a ball, a sheet, a tag or a disc in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Exercise:
    """What a detector is to find.

    Attributes:
        options: The detector's table, as a configuration would have it.
        patch: What is put into the pictures of the room, as it looks in one that is 480 px high; None for nothing,
            since the ball in the room is what is looked for.
    """

    options: Mapping[str, Any]
    patch: Image | None = field(default=None, compare=False)


def exercises() -> dict[str, Exercise]:
    """Return what each of stadimeter's own detectors is to find.

    Returns:
        The exercises, by the name of the detector.
    """
    return {
        "ball": Exercise(options={"diameter": "20 cm", "hsv": "29,86,6:64,255,255"}),
        "sheet": Exercise(options={"width": "11 in", "height": "8.5 in"}, patch=_sheet()),
        "tag": Exercise(options={"side": "8 cm", "family": "apriltag-36h11"}, patch=_tag()),
        "disc": Exercise(options={"diameter": "8 cm"}, patch=_disc()),
    }


def lens_for(width_px: int, height_px: int) -> CameraModel:
    """Return a camera model for a size of pictures.

    Args:
        width_px: Their width.
        height_px: Their height.

    Returns:
        The model.
    """
    focal_px = FIELD_OF_VIEW_FACTOR * width_px
    return CameraModel(
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
    )


def room_frames(lens: CameraModel, count: int = PICTURES) -> list[Frame]:
    """Draw pictures of the simulated room, in which a ball of 20 cm moves.

    Args:
        lens: The camera that sees it.
        count: How many.

    Returns:
        The pictures.
    """
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

    Returns:
        New pictures.
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


def _sheet() -> Image:
    """A bright sheet of letter paper with a dark rim, 110 px wide."""
    patch = np.full((105, 130, 3), 60, np.uint8)
    patch[10:95, 10:120] = 225
    return patch


def _tag() -> Image:
    """A tag of 70 px on white paper."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    patch = np.full((100, 100), 225, np.uint8)
    patch[15:85, 15:85] = np.maximum(cv2.aruco.generateImageMarker(dictionary, 0, 70), 20)
    return np.repeat(patch[:, :, np.newaxis], 3, axis=2)


def _disc() -> Image:
    """A bright disc of 80 px on something dark."""
    finer = 8
    patch = np.full((110 * finer, 110 * finer, 3), 60, np.uint8)
    cv2.circle(patch, (55 * finer, 55 * finer), 40 * finer, (225, 225, 225), cv2.FILLED)
    return np.asarray(cv2.resize(patch, (110, 110), interpolation=cv2.INTER_AREA), np.uint8)
