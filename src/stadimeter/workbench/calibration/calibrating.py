"""Reading the pictures of a calibration: targets at known distances, boards, and how the lens was set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import BoardView
from stadimeter.ranging.calibration import BIAS_STEP_PX, KnownDistance
from stadimeter.workbench.calibration.board_corners import Board
from stadimeter.workbench.calibration.exif import LensSettings, read_lens_settings
from stadimeter.workbench.measuring import open_picture

SAME_ZOOM = 0.005
"""Settings that differ by no more than this share count as the same: cameras round them."""

FOCUS_FACTOR = 3.0
"""Focusing this many times nearer or farther can change the focal length by some tenths of a per cent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardPictures:
    """What was found in the pictures of a board.

    Attributes:
        views: The corners, for each picture in which the board was found.
        missed: Picture and reason, for each in which it was not.
        width_px: The pictures' width.
        height_px: The pictures' height.
    """

    views: tuple[BoardView, ...]
    missed: tuple[tuple[str, str], ...]
    width_px: int
    height_px: int


def known_distance(
    path: Path, depth_m: float, target: NamedDetector, camera_model: CameraModel | None = None
) -> KnownDistance:
    """Look for the target in a picture of which the distance is known.

    Args:
        path: The picture file.
        depth_m: The known depth.
        target: The target's detector.
        camera_model: The lens, at any resolution of the picture's aspect; None where it is not known yet.

    Raises:
        PictureError: The picture cannot be read.
        CalibrationError: It has another aspect than the camera model.
    """
    frame = open_picture(path)
    return KnownDistance(
        picture=str(path),
        width_px=frame.width_px,
        height_px=frame.height_px,
        detection=target.detector.detect(frame, lens=camera_model and camera_model.scaled_to(*_size_px(frame))),
        size=target.detector.target_size,
        depth_m=depth_m,
    )


def with_bias_undone(
    known: Sequence[KnownDistance], choices: Sequence[DriverChoice], rough: CameraModel
) -> tuple[KnownDistance, ...]:
    """Look again with a camera model that has an edge bias, so that it can be told what an edge bias changes.

    Args:
        known: Pictures in which the target was found whole, all of one resolution.
        choices: The target's driver.
        rough: A camera model that was made from them, without an edge bias.

    Returns:
        The same pictures, with both answers.

    Raises:
        StadimeterError: A picture can no longer be read.
    """
    (target,) = build_detectors(choices, rough)
    return tuple(_asked_twice(each, target.detector, rough) for each in known)


def _asked_twice(known: KnownDistance, detector: Detector, rough: CameraModel) -> KnownDistance:
    frame = open_picture(Path(known.picture))
    found = detector.detect(frame, lens=rough)
    if found.status is not DetectionStatus.FOUND:
        return known
    biased = detector.detect(frame, lens=replace(rough, edge_bias_px=BIAS_STEP_PX))
    return replace(known, detection=found, less_bias=biased)


def _size_px(frame: Frame) -> tuple[int, int]:
    return frame.width_px, frame.height_px


def find_boards(paths: Sequence[Path], board: Board) -> BoardPictures:
    """Look for a board in pictures.

    Args:
        paths: The picture files, one at least.
        board: What to look for.

    Returns:
        The corners.

    Raises:
        PictureError: A picture cannot be read.
        CalibrationError: The pictures differ in resolution.
    """
    views: list[BoardView] = []
    missed: list[tuple[str, str]] = []
    shape = (0, 0)
    for path in paths:
        frame = open_picture(path)
        here = (frame.width_px, frame.height_px)
        shape = here if shape == (0, 0) else shape
        if here != shape:
            raise CalibrationError(
                f"{paths[0]} has {shape[0]}x{shape[1]} px, {path} has {here[0]}x{here[1]}; calibrate from pictures of "
                "one resolution, all held the same way"
            )
        found = board.find(str(path), frame.image)
        if isinstance(found, BoardView):
            views.append(found)
        else:
            missed.append((str(path), found))
    return BoardPictures(views=tuple(views), missed=tuple(missed), width_px=shape[0], height_px=shape[1])


def check_lens_settings(paths: Sequence[Path]) -> tuple[str, ...]:
    """Check that the lens was set the same way in all pictures, as far as their EXIF data tell.

    Args:
        paths: The picture files.

    Returns:
        Notes on what may matter: another focus.

    Raises:
        CalibrationError: Pictures have different zoom or lenses, so no one focal length fits them all.
    """
    settings = [(path, read_lens_settings(path)) for path in paths]
    for name, unit, attribute in _ZOOM:
        told = [(path, value) for path, each in settings if (value := getattr(each, attribute)) is not None]
        for path, value in told[1:]:
            if abs(value / told[0][1] - 1) > SAME_ZOOM:
                raise CalibrationError(
                    f"{told[0][0]} was taken with {name} {told[0][1]:g}{unit}, {path} with {value:g}{unit}: "
                    "another zoom or lens is another camera; calibrate from pictures of one"
                )
    return _focus_notes(settings)


_ZOOM = (
    ("focal length", " mm", "focal_length_mm"),
    ("35 mm equivalent", " mm", "focal_length_35mm_mm"),
    ("digital zoom", "", "digital_zoom"),
)


def _focus_notes(settings: Sequence[tuple[Path, LensSettings]]) -> tuple[str, ...]:
    told = [(each.subject_distance_m, path) for path, each in settings if each.subject_distance_m is not None]
    if len(told) < 2:
        return ()
    (near_m, near), (far_m, far) = min(told), max(told)
    if far_m <= FOCUS_FACTOR * near_m:
        return ()
    note = f"{near} was focused at {near_m:g} m, {far} at {far_m:g} m: focusing changes the focal length a little"
    return (f"{note}; fix the focus if the camera lets you",)
