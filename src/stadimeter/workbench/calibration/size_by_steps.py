"""The size of a target from pictures between which the camera was moved by known steps."""

from __future__ import annotations

import math
from pathlib import Path

from msgspec import Struct

from stadimeter.app.detectors import build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import LENGTHS_M, parse_quantity, split_quantities
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError, ConfigError, Problem
from stadimeter.ranging.measure import SeenTarget, measure
from stadimeter.ranging.size_from_motion import LearntSize, StepView, Vector, view_of
from stadimeter.workbench.calibration.live_distance import (
    FOUND_SHARE_MIN,
    FRAMES,
    apparent_px,
    fresh_frames,
    steady_size,
)
from stadimeter.workbench.frame_source import Source
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.picture_metadata import picture_remarks

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


class Looked(Struct, frozen=True, kw_only=True):
    """A picture in which a target of an assumed size was looked for; without a view it was not found whole."""

    picture: str
    detection: Detection
    view: StepView | None


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

    def look(self, picture: str, frame: Frame, moved_m: Vector) -> Looked:
        """Look for it in a frame.

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
        return Looked(picture=picture, detection=found, view=view)

    def look_in_file(self, path: Path, moved_m: Vector) -> Looked:
        """Look for it in a picture file; raises `PictureError` for what is none."""
        return self.look(str(path), open_picture(path), moved_m)

    def take(self, source: Source, name: str, moved_m: Vector) -> StepView:
        """Take frames of an open camera, and return how it is seen in the one of median size.

        Raises:
            CalibrationError: It was not found in most of the frames, or something moved.
        """
        frames = fresh_frames(source, FRAMES)
        looked = [self.look(name, frame, moved_m) for frame in frames]
        found = [(apparent_px(each.detection), each.detection, each.view) for each in looked if each.view is not None]
        if len(found) < max(1.0, FOUND_SHARE_MIN * len(frames)):
            missed = next(each for each in looked if each.view is None)
            why = "; ".join((missed.detection.reason, *picture_remarks(frames[0].image)))
            raise CalibrationError(f"{name} it was found in {len(found)} of {len(frames)} frames: {why}")
        found.sort(key=lambda each: each[0])
        _, detection, view = found[len(found) // 2]
        steady_size(name, detection, [each[0] for each in found])
        return view

    def sizes_m(self, learnt: LearntSize) -> dict[str, float]:
        """Return the learnt sizes by the keys of the target's table, and how well they are known as ``tolerance``."""
        sides_m = {key: learnt.factor * side_m for key, side_m in self._assumed_m().items()}
        # Of something with two sides the tolerance counts against their geometric mean, as its options have it.
        mean_m = math.prod(sides_m.values()) ** (1 / len(sides_m))
        return {**sides_m, "tolerance": learnt.sigma_share * mean_m}

    def _assumed_m(self) -> dict[str, float]:
        return {key: getattr(self._choice.options, key) for key in SIZE_KEYS if hasattr(self._choice.options, key)}
