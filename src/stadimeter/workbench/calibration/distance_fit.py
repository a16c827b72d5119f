"""A camera model from pictures of a target at known distances: from files, or from a camera a moment ago."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.camera_model import CameraModel, ToneCurve
from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError
from stadimeter.ranging.calibration import (
    BIAS_STEP_PX,
    DISTANCE_RELATIVE_SIGMA,
    Calibration,
    KnownDistance,
    calibrate,
    measured_depth_m,
    rough_model,
    with_readings,
)
from stadimeter.ranging.calibration_check import split_outliers
from stadimeter.workbench.measuring import remedies_for

# Returns the picture of a name: reads its file, or has kept it. It may raise `StadimeterError`.
FrameOf = Callable[[str], Frame]


class DistanceFit(Struct, frozen=True, kw_only=True):
    """A calibration, and what became of its pictures.

    Attributes:
        calibration: None if no picture can be used.
        usable: The pictures that it comes from, as they look through a rough camera model.
        left_out: Those in which the target is not found through that model, or the finished one.
        outliers: Those that contradict most of the others, and are left out for that.
        elsewhere: Those in which another thing is taken for the target than at first.
    """

    calibration: Calibration | None
    usable: tuple[KnownDistance, ...]
    left_out: tuple[KnownDistance, ...]
    outliers: tuple[KnownDistance, ...]
    elsewhere: tuple[KnownDistance, ...]

    @property
    def outlier_words(self) -> tuple[str, ...]:
        """A sentence on each outlier, with what the others make of it."""
        if self.calibration is None:
            return ()
        model = self.calibration.camera_model
        return tuple(
            f"{each.picture} contradicts the others and is left out: by them its distance is another by "
            f"{measured_depth_m(each, model) / each.depth_m - 1:+.1%}; check it, and that what was found is the target"
            for each in self.outliers
        )


def look_at_distance(
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

    The first look has no camera model yet, so it takes the tone curve for that of sRGB. What counts is a second one
    through the model that it gives, which is that of `measure`; what the finished file reads is found by a third. No
    picture counts that is refused through the finished file, so what calibrates is measured.

    Pictures that contradict most of the others are left out, and count no more than those not found.

    Raises:
        CalibrationError: The pictures differ in resolution, or in how the camera was set, contradict each other, or do
            not tell the focal length.
        StadimeterError: A picture can no longer be read.
    """
    plain = rough_model(known)
    optics = frame_of(known[0].picture).optics
    rough = replace(plain, tone_curve=tone_curve, optics=optics)
    looked = _look_again(known, frame_of, choices, rough)
    usable, left_out = _split_by_found(looked, looked)
    pairs = zip(known, looked, strict=True)
    elsewhere = tuple(again for before, again in pairs if again in usable and _is_elsewhere(before, again))
    finished: Calibration | None = None
    outliers: tuple[KnownDistance, ...] = ()
    while usable and finished is None:
        if len(usable) > 1:  # one picture cannot tell the edge bias
            usable = _with_bias_undone(usable, frame_of, choices, rough)
        usable, contradicting = split_outliers(usable, distance_relative_sigma=distance_relative_sigma)
        outliers += contradicting
        made = calibrate(usable, date=date, distance_relative_sigma=distance_relative_sigma)
        made = replace(made, camera_model=replace(made.camera_model, tone_curve=tone_curve, optics=optics))
        again = _look_again(usable, frame_of, choices, made.camera_model)
        usable, lost = _split_by_found(usable, again)
        left_out += lost
        finished = None if lost else with_readings(made, again)
    return DistanceFit(calibration=finished, usable=usable, left_out=left_out, outliers=outliers, elsewhere=elsewhere)


def _split_by_found(
    known: Sequence[KnownDistance], again: Sequence[KnownDistance]
) -> tuple[tuple[KnownDistance, ...], tuple[KnownDistance, ...]]:
    """Return the pictures in which the target is found again, and those looked at again in which it is not."""
    is_found = [each.is_usable for each in again]
    found = tuple(each for each, is_good in zip(known, is_found, strict=True) if is_good)
    return found, tuple(each for each, is_good in zip(again, is_found, strict=True) if not is_good)


def remedy_words(
    left_out: KnownDistance, frame: Frame, choice: DriverChoice, camera_model: CameraModel | None = None
) -> str:
    """Say what to change in the target's options so that it is found in a picture of which the distance is known.

    Args:
        left_out: The picture in which it was not found.
        camera_model: The camera's lens; None where the picture shall calibrate it, which the change then makes it do.

    Returns:
        A clause that follows the reason why it was not found; empty where no change helps.
    """

    def calibrate_changed(changed: DriverChoice) -> Detection | None:
        return _calibrate_one(left_out, frame, changed)

    lens = camera_model and camera_model.for_frame(frame)
    remedies = remedies_for(choice, left_out.detection, frame, lens, None if lens else calibrate_changed)
    return f"; it is found with {' or '.join(map(str, remedies))}" if remedies else ""


def _calibrate_one(left_out: KnownDistance, frame: Frame, choice: DriverChoice) -> Detection | None:
    """Calibrate from one picture, and return where the target is in it; None where it does not calibrate."""
    (target,) = build_detectors([choice], None)
    known = look_at_distance(left_out.picture, frame, left_out.depth_m, target)
    if not known.is_usable:
        return None
    try:
        fit = fit_distances(
            [known],
            lambda _: frame,
            [choice],
            date="",
            distance_relative_sigma=DISTANCE_RELATIVE_SIGMA,
            tone_curve="srgb",
        )
    except CalibrationError:
        return None
    return fit.usable[0].detection if fit.usable else None


def _look_again(
    known: Sequence[KnownDistance], frame_of: FrameOf, choices: Sequence[DriverChoice], model: CameraModel
) -> tuple[KnownDistance, ...]:
    """Look again through a camera model, as `measure` will: with it a detector knows shapes and edges better."""
    (target,) = build_detectors(choices, model)
    again = (look_at_distance(each.picture, frame_of(each.picture), each.depth_m, target, model) for each in known)
    return tuple(replace(each, is_confirmed=before.is_confirmed) for before, each in zip(known, again, strict=True))


def _with_bias_undone(
    known: Sequence[KnownDistance], frame_of: FrameOf, choices: Sequence[DriverChoice], rough: CameraModel
) -> tuple[KnownDistance, ...]:
    """Look again with a camera model that has an edge bias, to see what an edge bias changes.

    Args:
        known: Pictures in which the target was found whole through the rough model.
        rough: A camera model that was made from them, without an edge bias.
    """
    biased = _look_again(known, frame_of, choices, replace(rough, edge_bias_px=BIAS_STEP_PX))
    return tuple(replace(each, less_bias=less.detection) for each, less in zip(known, biased, strict=True))


def _is_elsewhere(known: KnownDistance, again: KnownDistance) -> bool:
    """Check whether another thing was taken for the target: its centre is off by more than half its size."""
    size_px = max(known.detection.width_px, known.detection.height_px)
    return math.dist(known.detection.centre_px, again.detection.centre_px) > size_px / 2
