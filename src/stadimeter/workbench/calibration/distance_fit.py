"""A camera model from pictures of a target at known distances: from files, or from a camera a moment ago."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.camera_model import CameraModel, ToneCurve
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.ranging.calibration import BIAS_STEP_PX, Calibration, KnownDistance, calibrate, with_readings

FrameOf = Callable[[str], Frame]
"""Returns the picture of a name: reads its file, or has kept it. It may raise `StadimeterError`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceFit:
    """A calibration, and what became of its pictures.

    Attributes:
        calibration: None if no picture can be used.
        usable: The pictures that it comes from, as they look through a rough camera model.
        left_out: Those in which the target is not found through that model.
        elsewhere: Those in which another thing is taken for the target than at first.
    """

    calibration: Calibration | None
    usable: tuple[KnownDistance, ...]
    left_out: tuple[KnownDistance, ...]
    elsewhere: tuple[KnownDistance, ...]


def known_distance(
    name: str, frame: Frame, depth_m: float, target: NamedDetector, camera_model: CameraModel | None = None
) -> KnownDistance:
    """Look for the target in a picture of which the distance is known.

    Args:
        name: The picture's name, for messages, and to find it again.
        camera_model: The lens, at any resolution of the picture's aspect; None where it is not known yet.

    Raises:
        CalibrationError: It has another aspect than the camera model.
    """
    return KnownDistance(
        picture=name,
        width_px=frame.width_px,
        height_px=frame.height_px,
        detection=target.detector.detect(frame, lens=camera_model and camera_model.for_frame(frame)),
        size=target.detector.target_shape,
        depth_m=depth_m,
    )


def fit_distances(
    known: Sequence[KnownDistance],
    frame_of: FrameOf,
    choices: Sequence[DriverChoice],
    *,
    date: str,
    distance_relative_sigma: float,
    tone_curve: ToneCurve,
) -> DistanceFit:
    """Calibrate from pictures in which the target was found whole.

    The first look has no camera model yet, so it takes the tone curve for that of sRGB and knows less of shapes. What
    counts is a second one through the model that it gives, which is that of `measure`; what the finished file reads
    is found by a third.

    Raises:
        CalibrationError: The pictures differ in resolution, or do not tell the focal length.
        StadimeterError: A picture can no longer be read.
    """
    made = calibrate(known, date=date, distance_relative_sigma=distance_relative_sigma)
    rough = replace(made.camera_model, edge_bias_px=0.0, tone_curve=tone_curve)
    looked = _looked_at_again(known, frame_of, choices, rough)
    usable = tuple(each for each in looked if each.detection.status is DetectionStatus.FOUND)
    pairs = zip(known, looked, strict=True)
    elsewhere = tuple(again for before, again in pairs if again in usable and _is_elsewhere(before, again))
    left_out = tuple(each for each in looked if each not in usable)
    if not usable:
        return DistanceFit(calibration=None, usable=(), left_out=left_out, elsewhere=())
    if len(usable) > 1:  # one picture cannot tell the edge bias
        usable = _with_bias_undone(usable, frame_of, choices, rough)
    made = calibrate(usable, date=date, distance_relative_sigma=distance_relative_sigma)
    made = replace(made, camera_model=replace(made.camera_model, tone_curve=tone_curve))
    made = with_readings(made, _looked_at_again(usable, frame_of, choices, made.camera_model))
    return DistanceFit(calibration=made, usable=usable, left_out=left_out, elsewhere=elsewhere)


def _looked_at_again(
    known: Sequence[KnownDistance], frame_of: FrameOf, choices: Sequence[DriverChoice], model: CameraModel
) -> tuple[KnownDistance, ...]:
    """Look again through a camera model, as `measure` will: with it a detector knows shapes and edges better."""
    (target,) = build_detectors(choices, model)
    return tuple(known_distance(each.picture, frame_of(each.picture), each.depth_m, target, model) for each in known)


def _with_bias_undone(
    known: Sequence[KnownDistance], frame_of: FrameOf, choices: Sequence[DriverChoice], rough: CameraModel
) -> tuple[KnownDistance, ...]:
    """Look again with a camera model that has an edge bias, to see what an edge bias changes.

    Args:
        known: Pictures in which the target was found whole through the rough model.
        rough: A camera model that was made from them, without an edge bias.
    """
    biased = _looked_at_again(known, frame_of, choices, replace(rough, edge_bias_px=BIAS_STEP_PX))
    return tuple(replace(each, less_bias=less.detection) for each, less in zip(known, biased, strict=True))


def _is_elsewhere(known: KnownDistance, again: KnownDistance) -> bool:
    """Return whether another thing was taken for the target: its centre is off by more than half its size."""
    size_px = max(known.detection.width_px, known.detection.height_px)
    return math.dist(known.detection.centre_px, again.detection.centre_px) > size_px / 2
