"""What is measured: detectors by the names of their entry points, and the measurement of what they find."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stadimeter.cameras.image_files import subsampling_of
from stadimeter.config.plugins import DETECTORS, DriverContext, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.core.measurement import Measurement
from stadimeter.detectors.protocol import Detector
from stadimeter.testing.rig import ManualClock
from support.scenes import draw
from support.scenes.scene import RenderedScene, Truth
from support.through_lens import ThroughLens

BALL_HSV = "29,86,6:64,255,255"
PREDICTION_SIGMA_PX = 2.0

OPTIONS: dict[str, dict[str, Any]] = {
    "ball": {"diameter": f"{draw.TENNIS_M} m", "hsv": BALL_HSV},
    "ball of any colour": {"diameter": f"{draw.TENNIS_M} m"},
    "large ball": {"diameter": f"{draw.LARGE_BALL_M} m", "hsv": BALL_HSV},
    "sheet": {"width": f"{draw.SHEET_M[0]} m", "height": f"{draw.SHEET_M[1]} m"},
    "disc": {"diameter": f"{draw.DISC_M} m"},
    "tag": {"side": f"{draw.TAG_M} m", "family": draw.TAG_FAMILY},
}
"""What each detector is told, by the name of the target."""

DRIVERS = {"large ball": "ball", "ball of any colour": "ball", "plain sheet": "sheet"}
"""Which entry point a target's detector has, where the names differ."""


@cache
def detector(target: str, camera: CameraModel | None, **changes: Any) -> ThroughLens:
    """Return the detector for a target, with the options that the benchmarks use."""
    model = load_driver(DETECTORS, DRIVERS.get(target, target))
    options = model.model_validate(OPTIONS.get(target, {}) | changes)
    made: Detector = options.build(DriverContext(name=target, clock=ManualClock(), camera_model=camera))
    return ThroughLens(made, camera)


def framed(picture: Image | RenderedScene) -> Frame:
    """Return a frame with this picture, as a camera's driver gives it."""
    if isinstance(picture, RenderedScene):
        return Frame(picture.image, 0.0, 0, subsampling=picture.subsampling)
    return Frame(picture, 0.0, 0)


def read(path: Path) -> Frame:
    """Return a frame with the picture of a file."""
    image = cv2.imread(str(path))
    if image is None:
        raise FileNotFoundError(f"{path} is no picture that OpenCV can read")
    return Frame(np.asarray(image, np.uint8), 0.0, 0, subsampling=subsampling_of(path.read_bytes()))


def measure(finder: ThroughLens, picture: Image | RenderedScene, prediction: Prediction | None = None) -> Measurement:
    """Look for the target and measure how far away it is, as a run does."""
    return finder.measure(framed(picture), prediction)


def prediction_of(truth: Truth) -> Prediction:
    """Return where a tracker would expect the target that is there."""
    outline = truth.outline_px
    x, y = (outline.min(axis=0) + outline.max(axis=0)) / 2
    size_px = truth.apparent_px if len(outline) > 4 else float(np.linalg.norm(np.diff(outline, axis=0), axis=1).max())
    # A tracker knows corners from the last frame, so they are off by about as much as the centre may be.
    corners = outline + PREDICTION_SIGMA_PX * math.sqrt(0.5) if len(outline) == 4 else None
    return Prediction(centre_px=(float(x), float(y)), size_px=size_px, sigma_px=PREDICTION_SIGMA_PX, outline_px=corners)
