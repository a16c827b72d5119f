"""Pictures for a page: the target looked for in one, before the answers are complete, drawn and described."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from stadimeter.app.detectors import build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.core.measurement import Measurement
from stadimeter.core.words import metres
from stadimeter.errors import PictureError, StadimeterError
from stadimeter.workbench.annotation import Mark, annotate
from stadimeter.workbench.measuring import Measuring
from stadimeter.workbench.picture_metadata import picture_remarks
from stadimeter.workbench.setup.question import Known
from stadimeter.workbench.setup.target import build_target, describe_detection, kind_of, kind_steps

JPEG_QUALITY = 80

DRAWINGS = ("plain", "target", "mask")


def target_so_far(known: Known, colour: str = "") -> DriverChoice | None:
    """Return the target as far as the answers tell it; None before it can be looked for.

    Args:
        colour: A range that is tried; empty for that of the answers.
    """
    answers = known.answers
    if "target" not in answers or any(step.key not in answers for step in kind_steps(answers)):
        return None
    if kind_of(answers).has_colour and not (colour or "colour" in answers):
        return None
    try:
        return build_target(known, **({"colour": colour} if colour else {}))
    except StadimeterError:
        return None


def look_for_target(known: Known, frame: Frame, target: DriverChoice) -> tuple[Detection, Measurement | None]:
    """Look for the target in a frame, and measure it if the lens is known already."""
    (named,) = build_detectors([target], known.camera_model)
    if known.camera_model is None:
        return named.detector.detect(frame), None
    result = Measuring([named], known.camera_model).measure(frame, "").targets[0]
    return result.detection or Detection(target=target.name, status=DetectionStatus.NOT_FOUND), result.measurement


def describe_picture(frame: Frame, seen: Detection | None, measured: Measurement | None) -> Mapping[str, Any]:
    """Describe what is known of a picture, as JSON has it; places are in the camera's own pixels."""
    remarks = [f"{each[0].upper()}{each[1:]}." for each in picture_remarks(frame.image, frame.exposure_s)]
    return {
        "width_px": frame.width_px,
        "height_px": frame.height_px,
        "exposure_s": frame.exposure_s,
        "remarks": remarks,
        "words": describe_detection(seen.target, seen) if seen else "",
        "found": seen is not None and seen.is_whole,
        "distance_m": measured.distance_m if measured else None,
        "sigma_m": measured.sigma_m if measured else None,
    }


def draw_findings(frame: Frame, seen: Detection, measured: Measurement | None) -> Image:
    """Return the picture with the target's outline."""
    headline = seen.target
    if measured is not None and measured.distance_m is not None:
        headline = f"{headline}: {metres(measured.distance_m, measured.sigma_m or 0.0)}"
    mark = Mark(detection=seen, has_corners=len(seen.outline_px) == 4, headline=headline)
    return annotate(frame.image, [mark])


def encode_jpeg(image: Image, width_px: int = 0) -> bytes:
    """Return a picture as JPEG, no wider than asked for; 0 for as it is."""
    if 0 < width_px < image.shape[1]:
        height_px = max(1, round(image.shape[0] * width_px / image.shape[1]))
        image = np.asarray(cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA), np.uint8)
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise PictureError("the picture cannot be encoded")
    return data.tobytes()
