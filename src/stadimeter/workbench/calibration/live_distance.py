"""Calibrating by a target at known distances, in pictures or before the camera; its size by moving the camera."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import LENGTHS_M, parse_quantity, split_quantities
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError, ConfigError, Problem
from stadimeter.ranging.calibration import (
    BIAS_STEP_PX,
    Calibration,
    KnownDistance,
    calibrate,
    check_agreement,
    rough_model,
    with_readings,
)
from stadimeter.ranging.measure import SeenTarget, measure
from stadimeter.ranging.size_from_motion import LearntSize, StepView, Vector, view_of
from stadimeter.workbench.calibration.board_session import today
from stadimeter.workbench.frame_source import SETTLING_WAIT_S, Source
from stadimeter.workbench.measuring import remedies_for
from stadimeter.workbench.picture_metadata import picture_remarks

# A camera model from pictures of a target at known distances: from files, or from a camera a moment ago ---------------

# Returns the picture of a name: reads its file, or has kept it. It may raise `StadimeterError`.
FrameOf = Callable[[str], Frame]


class DistanceFit(Struct, frozen=True, kw_only=True):
    """A calibration, and what became of its pictures.

    Attributes:
        calibration: None if no picture can be used.
        left_out: Those in which the target is not found through that model, or the finished one.
        elsewhere: Those in which another thing is taken for the target than at first.
    """

    calibration: Calibration | None
    left_out: tuple[KnownDistance, ...]
    elsewhere: tuple[KnownDistance, ...]


# Further from the middle of the picture than this, depth and straight line differ by more than 1.5 %.
FAR_OFF_AXIS_RAD = math.radians(10)


def off_axis_words(picture: str, off_axis_rad: float, away: str) -> str:
    """Say that a distance was taken as depth, if the straight line to the target differs; else return nothing.

    Args:
        away: The distance as people write it.
    """
    if off_axis_rad <= FAR_OFF_AXIS_RAD:
        return ""
    return (
        f"{picture}: the target is {math.degrees(off_axis_rad):.0f}° from the middle of the picture; {away} was taken "
        "as its depth, so the straight line to it is longer"
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
    try:
        lens = camera_model and camera_model.for_frame(frame)
    except CalibrationError as error:
        raise CalibrationError(f"{name}: {error}") from error
    return KnownDistance(
        picture=name,
        width_px=frame.width_px,
        height_px=frame.height_px,
        detection=target.detector.detect(frame, lens=lens),
        size=target.detector.target_shape,
        depth_m=depth_m,
    )


def fit_distances(
    known: Sequence[KnownDistance],
    frame_of: FrameOf,
    choices: Sequence[DriverChoice],
    *,
    distance_relative_sigma: float,
) -> DistanceFit:
    """Calibrate from pictures in which the target was found whole.

    The first look has no camera model yet. What counts is a second one through the model that it gives, which is that
    of `measure`; what the finished file reads is found by a third. No picture counts that is refused through the
    finished file, so what calibrates is measured.

    Raises:
        CalibrationError: The pictures differ in resolution, or in how the camera was set, contradict each other, or do
            not tell the focal length.
        StadimeterError: A picture can no longer be read.
    """
    optics = frame_of(known[0].picture).optics
    rough = replace(rough_model(known), optics=optics)
    looked = _look_again(known, frame_of, choices, rough)
    usable = tuple(each for each in looked if each.is_usable)
    left_out = tuple(each for each in looked if not each.is_usable)
    pairs = zip(known, looked, strict=True)
    elsewhere = tuple(again for before, again in pairs if again.is_usable and _is_elsewhere(before, again))
    finished: Calibration | None = None
    while usable and finished is None:
        if len(usable) > 1:  # a look with an edge bias shows what one changes; one picture cannot tell it
            biased = _look_again(usable, frame_of, choices, replace(rough, edge_bias_px=BIAS_STEP_PX))
            both = zip(usable, biased, strict=True)
            usable = tuple(replace(each, less_bias=less.detection) for each, less in both)
        check_agreement(usable, distance_relative_sigma=distance_relative_sigma)
        made = calibrate(usable, date=today(), distance_relative_sigma=distance_relative_sigma)
        made = replace(made, camera_model=replace(made.camera_model, optics=optics))
        again = _look_again(usable, frame_of, choices, made.camera_model)
        usable = tuple(each for each, found in zip(usable, again, strict=True) if found.is_usable)
        left_out += tuple(each for each in again if not each.is_usable)
        finished = with_readings(made, again) if len(usable) == len(again) else None
    return DistanceFit(calibration=finished, left_out=left_out, elsewhere=elsewhere)


def remedy_words(
    left_out: KnownDistance, frame: Frame, choice: DriverChoice, camera_model: CameraModel | None = None
) -> str:
    """Say what to change in the target's options so that it is found in a picture of which the distance is known.

    Args:
        left_out: The picture in which it was not found.
        camera_model: The camera's lens; None where the picture shall calibrate it.

    Returns:
        A clause that follows the reason why it was not found; empty where no change helps.
    """
    remedies = remedies_for(choice, left_out.detection, frame, camera_model and camera_model.for_frame(frame))
    return f"; it is found with {' or '.join(map(str, remedies))}" if remedies else ""


def _look_again(
    known: Sequence[KnownDistance], frame_of: FrameOf, choices: Sequence[DriverChoice], model: CameraModel
) -> tuple[KnownDistance, ...]:
    """Look again through a camera model, as `measure` will: with it a detector knows shapes and edges better."""
    (target,) = build_detectors(choices, model)
    again = (look_at_distance(each.picture, frame_of(each.picture), each.depth_m, target, model) for each in known)
    return tuple(replace(each, is_confirmed=before.is_confirmed) for before, each in zip(known, again, strict=True))


def _is_elsewhere(known: KnownDistance, again: KnownDistance) -> bool:
    """Check whether another thing was taken for the target: its centre is off by more than half its size."""
    size_px = max(known.detection.width_px, known.detection.height_px)
    return math.dist(known.detection.centre_px, again.detection.centre_px) > size_px / 2


# How many frames to take at each distance.
FRAMES = 9

# The frames of one distance are kept until their median is known; of very large ones fewer are taken.
FRAMES_MAX_BYTES = 150_000_000

# Below this share of frames with the target, a find may be anything.
FOUND_SHARE_MIN = 0.5

# If sizes spread more than by this share, and by this many times what the detector expects, something moved.
SPREAD_SHARE_MAX = 0.01
SPREAD_SIGMAS_MAX = 4.0


class Take(Struct, frozen=True, eq=False):
    """The frame that counts of several at one distance, what was found in it, and how, in words."""

    known: KnownDistance
    frame: Frame
    words: str


def take_at(source: Source, choice: DriverChoice, distance_m: float, name: str = "") -> Take:
    """Take frames of the target where it is now, before an open camera.

    The frame of median size counts: the common error of all of them, that of the tape, would not get smaller by
    counting each.

    Args:
        distance_m: From the lens to the nearest point of the target: of a ball its near side.
        name: What to call it in messages.

    Raises:
        CalibrationError: The target was not found in most of the frames, or something moved.
        DriverError: The camera gives no frames.
        EndOfFramesError: It is a recording, and at its end.
    """
    name = name or f"at {distance_m:g} m"
    (target,) = build_detectors([choice], None)
    depth_m = distance_m + target.detector.target_shape.limb_radius_m
    seen = [(look_at_distance(name, frame, depth_m, target), frame) for frame in fresh_frames(source)]
    found = [pair for pair in seen if pair[0].is_usable]
    if len(found) < max(1.0, FOUND_SHARE_MIN * len(seen)):
        missed = [pair for pair in seen if not pair[0].is_usable]
        raise CalibrationError(_why_not_found(name, missed, len(seen), choice))
    found.sort(key=lambda pair: apparent_px(pair[0].detection))
    known, frame = found[len(found) // 2]
    size_px, spread_share = steady_size(name, known.detection, [apparent_px(each.detection) for each, _ in found])
    words = f"found in {len(found)} of {len(seen)} frames, {size_px:.0f} px, spread {spread_share:.1%}"
    return Take(known, frame, words)


def fresh_frames(source: Source) -> Sequence[Frame]:
    """Return fresh frames of an open camera: the one that waited may show the hand that put the target there."""
    if source.is_live:
        source.capture.latest(SETTLING_WAIT_S)
    first = source.capture.latest(SETTLING_WAIT_S)
    number = max(1, min(FRAMES, FRAMES_MAX_BYTES // first.image.nbytes))
    return [first, *(source.capture.latest(SETTLING_WAIT_S) for _ in range(number - 1))]


def _why_not_found(name: str, missed: Sequence[tuple[KnownDistance, Frame]], frames: int, choice: DriverChoice) -> str:
    known, frame = missed[0]
    why = f"{known.detection.reason}{remedy_words(known, frame, choice)}"
    reasons = "; ".join((why, *picture_remarks(frame.image)))
    return f"{name} the target was found in {frames - len(missed)} of {frames} frames: {reasons}"


def steady_size(name: str, detection: Detection, sizes_px: Sequence[float]) -> tuple[float, float]:
    """Return the median size and its spread as a share; raises `CalibrationError` if something moved meanwhile."""
    size_px = statistics.median(sizes_px)
    # 1.4826 times the median of the absolute deviations is the standard deviation, whatever single frames show.
    spread_share = 1.4826 * statistics.median(abs(each - size_px) for each in sizes_px) / size_px
    expected_share = detection.size_sigma_px / size_px
    if spread_share > max(SPREAD_SHARE_MAX, SPREAD_SIGMAS_MAX * expected_share):
        raise CalibrationError(
            f"{name} the target's size changed by {spread_share:.1%} from frame to frame: keep the target and the"
            " camera still, and lock focus and exposure if the camera lets you"
        )
    return size_px, spread_share


def apparent_px(detection: Detection) -> float:
    """Return the apparent size of a target that was found, one figure for both axes."""
    return math.sqrt(detection.width_px * detection.height_px)


# The size of a target from pictures between which the camera was moved by known steps.

# What the options of a target call its size; a detector of another package that has none of them learns none.
SIZE_KEYS = ("diameter", "side", "width", "height")


# The directions of steps, in the camera frame: x right, y down, z ahead.
DIRECTIONS: dict[str, Vector] = {
    "nearer": (0.0, 0.0, 1.0),
    "ahead": (0.0, 0.0, 1.0),
    "back": (0.0, 0.0, -1.0),
    "right": (1.0, 0.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "down": (0.0, 1.0, 0.0),
    "up": (0.0, -1.0, 0.0),
}


def parse_move(text: str, what: str) -> Vector:
    """Return a move such as ``20cm`` or ``20cm,5cm:up`` in metres; the `ConfigError` names what it is the move of."""
    x_m = y_m = z_m = 0.0
    for part in split_quantities(text):
        length, colon, word = part.partition(":")
        direction = DIRECTIONS.get(word.strip().lower()) if colon else DIRECTIONS["ahead"]
        if direction is None:
            raise ConfigError(f"{what}: {word!r} is no direction; write one of {', '.join(DIRECTIONS)}")
        try:
            way_m = parse_quantity(length, LENGTHS_M, "20 cm")
        except ValueError as error:
            raise ConfigError([Problem(str(error), key=what)]) from error
        x_m, y_m, z_m = x_m + way_m * direction[0], y_m + way_m * direction[1], z_m + way_m * direction[2]
    return x_m, y_m, z_m


class SizeSession:
    """Looks for one target of an assumed size in pictures after steps of the camera."""

    def __init__(self, choice: DriverChoice, camera_model: CameraModel) -> None:
        self._choice, self._camera_model = choice, camera_model
        if not self._assumed_m():
            raise ConfigError(
                f"a target of the kind {choice.driver} has no size to learn: none of {', '.join(SIZE_KEYS)}"
            )
        (self._target,) = build_detectors([choice], camera_model)
        self._number: int | None = None

    def look(self, picture: str, frame: Frame, moved_m: Vector) -> tuple[Detection, StepView | None]:
        """Look for it in a frame; without a view it was not found whole.

        Raises:
            CalibrationError: The frame has another aspect than the camera model, or shows another one of its kind.
        """
        lens, shape = self._camera_model.for_frame(frame), self._target.detector.target_shape
        found = self._target.detector.detect(frame, lens=lens)
        seen = SeenTarget(detection=found, measurement=measure(found, shape, lens, 0.0), shape=shape)
        view = view_of(picture, seen, lens, moved_m)
        if view is not None and found.number is not None:
            if self._number not in {None, found.number}:
                raise CalibrationError(
                    f"{picture} shows number {found.number}, an earlier picture {self._number}; say which one is meant "
                    f"with --id {self._number}"
                )
            self._number = found.number
        return found, view

    def sizes_m(self, learnt: LearntSize) -> dict[str, float]:
        """Return the learnt sizes by the keys of the target's table, and how well they are known as ``tolerance``."""
        sides_m = {key: learnt.factor * side_m for key, side_m in self._assumed_m().items()}
        # Of something with two sides the tolerance counts against their geometric mean, as its options have it.
        mean_m = math.prod(sides_m.values()) ** (1 / len(sides_m))
        return {**sides_m, "tolerance": learnt.sigma_share * mean_m}

    def _assumed_m(self) -> dict[str, float]:
        return {key: getattr(self._choice.options, key) for key in SIZE_KEYS if hasattr(self._choice.options, key)}
