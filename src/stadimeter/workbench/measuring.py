"""Measuring targets in picture files, one after the other: a bad picture does not stop the others.

For a target that is refused, the options that its detector proposes are tried on the picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.clock import SteppedClock
from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.cameras.protocol import Camera
from stadimeter.config.files import holds_video, open_untrusted
from stadimeter.config.plugins import CAMERAS, DriverChoice, DriverContext, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Mount
from stadimeter.core.detection import Detection, DetectionStatus, Points, RejectedCandidate, no_points
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.detectors.protocol import Detector, FindsSeveral, KnowsRemedies, Remedy, ShowsEdges, TracksSeveral
from stadimeter.errors import PictureError, StadimeterError, UnreadableError
from stadimeter.perception.perceiver import Perceiver, Several
from stadimeter.ranging.floor import OnFloor, stand
from stadimeter.ranging.measure import (
    SeenTarget,
    Separation,
    SigmaParts,
    direction_sigmas_rad,
    measure,
    separation,
    sigma_parts,
    unmeasured,
)

if TYPE_CHECKING:
    from stadimeter.workbench.frame_source import Source


# Endings of the names of videos, in lower case.
VIDEO_SUFFIXES = (
    ".264", ".265", ".avi", ".flv", ".h264", ".h265", ".hevc", ".m2ts", ".m4v", ".mjpeg", ".mjpg", ".mkv", ".mov",
    ".mp4", ".mpeg", ".mpg", ".mts", ".ts", ".webm", ".wmv",
)  # fmt: skip


# Fields of a measurement that ``--json`` prints under their names, and what it calls the sigmas of the direction.
RECORDED = ("distance_m", "depth_m", "sigma_m", "bearing_rad", "elevation_rad", "tilt_rad", "ambiguity", "reason")
DIRECTION_SIGMAS = ("bearing_sigma_rad", "elevation_sigma_rad")


class TargetResult(Struct, frozen=True, kw_only=True, eq=False):
    """Result for one target in one picture.

    Attributes:
        detection: Where the target is; None if the picture could not be read.
        parts: The components of the standard deviation; None without a distance.
        rejected_from: The number of the first of the candidates that were rejected. They are counted through all
            targets of a picture, so that a number means one place in it.
        direction_sigmas_rad: Standard deviations of bearing and elevation; None without a distance.
        find_edges: Returns its edge points, shape ``(n, 2)``; empty for a detector that does not show them.
        seen: It with its shape; None if the picture could not be read.
        mount: Where the camera sits on a robot; None for on none.
        floor: It by its size and by the floor; None of a target that need not be on it.
        frame: The frame of a video or a camera, counted from 0; None of a picture.
        time_s: When it was captured, from the first one on; None of a picture.
    """

    file: str
    measurement: Measurement
    detection: Detection | None = None
    has_corners: bool = False
    parts: SigmaParts | None = None
    rejected_from: int = 1
    direction_sigmas_rad: tuple[float, float] | None = None
    find_edges: Callable[[], Points] = no_points
    seen: SeenTarget | None = None
    floor: OnFloor | None = None
    mount: Mount | None = None
    frame: int | None = None
    time_s: float | None = None

    @property
    def rejected(self) -> tuple[tuple[int, RejectedCandidate], ...]:
        """Rejected candidates, each with its number."""
        candidates = self.detection.rejected if self.detection else ()
        return tuple(enumerate(candidates, start=self.rejected_from))

    @property
    def label(self) -> str:
        """The target's name, and the number of the tag that was found."""
        name, number = self.measurement.target, self.detection and self.detection.number
        return name if number is None or name.endswith((f" {number}", f"-{number}")) else f"{name} {number}"

    @property
    def note(self) -> str:
        """A remark to make of it beside the distance; empty for nothing."""
        return ""

    def more(self) -> Iterator[tuple[str, str]]:
        """Yield further lines that explain it, each with its label."""
        yield from ()

    def record(self) -> dict[str, object]:
        """Return the result as the object that ``--json`` prints: lengths in metres, angles in radians."""
        measured = self.measurement
        is_perhaps = measured.status is MeasurementStatus.PERHAPS
        in_robot = {}
        if self.mount is not None:
            place_m = None if measured.position_m is None else self.mount.in_robot(measured.position_m)
            in_robot = dict(zip(("robot_x_m", "robot_y_m", "robot_z_m"), place_m or (None,) * 3, strict=True))
        return {
            "file": self.file,
            "target": measured.target,
            "status": (MeasurementStatus.MEASURED if is_perhaps else measured.status).value,
            "perhaps": is_perhaps,
            **{key: getattr(measured, key) for key in RECORDED},
            **dict(zip(("x_m", "y_m", "z_m"), measured.position_m or (None,) * 3, strict=True)),
            **dict(zip(DIRECTION_SIGMAS, self.direction_sigmas_rad or (None, None), strict=True)),
            "outline_px": self.detection.outline_px.round(2).tolist() if self.detection else [],
            "id": self.detection.number if self.detection else None,
            "frame": self.frame,
            "time_s": self.time_s,
            **in_robot,
        }


class PictureResult(Struct, frozen=True, kw_only=True, eq=False):
    """Results of one picture; without a frame it could not be read."""

    file: str
    frame: Frame | None
    targets: tuple[TargetResult, ...]


def is_video_file(path: Path) -> bool:
    """Check whether a file is a video, by its name or by how it begins."""
    return path.suffix.lower() in VIDEO_SUFFIXES or holds_video(path)


def open_picture(path: Path) -> Frame:
    """Read a picture file through the ``images`` camera.

    Raises:
        PictureError: It is missing, a folder, empty, damaged, or not a picture.
    """
    try:  # the camera takes folders and patterns, too
        open_untrusted(path).close()
    except UnreadableError as error:
        raise PictureError(f"the picture {path} cannot be read: {error.reason}") from error
    options = load_driver(CAMERAS, "images").model_validate({"paths": [str(path)]})
    camera: Camera = options.build(DriverContext(name="pictures", clock=SteppedClock()))
    camera.open()
    try:
        return camera.read()
    finally:
        camera.close()


class Measuring:
    """Measures targets in one frame after the other, each as if there had been none before.

    Only the names of several of one kind go on through the frames of a source.

    Args:
        camera_model: The lens, at any resolution of the frames' aspect.
    """

    def __init__(self, targets: Sequence[NamedDetector], camera_model: CameraModel, mount: Mount | None = None) -> None:
        self.targets = targets
        self._mount = mount
        self._perceiver = Perceiver({}, camera_model)
        self._several: dict[str, Several] = {}

    def measure_file(self, path: Path) -> PictureResult:
        """Return a result for each target of a picture file.

        Where the picture cannot be read, or has another aspect than the camera model, the status is ``error`` and the
        reason says why.
        """
        frame = None
        try:
            frame = open_picture(path)
            return self.measure(frame, str(path))
        except StadimeterError as error:
            return PictureResult(file=str(path), frame=frame, targets=failed_results(str(path), self.targets, error))

    def measure(self, frame: Frame, file: str) -> PictureResult:
        """Return a result for each target of a picture; of tags without a number, one for each that is seen.

        Raises:
            CalibrationError: The frame has another aspect than the camera model.
        """
        self._several.clear()
        return self._measure(frame, file)

    def _measure(self, frame: Frame, file: str) -> PictureResult:
        lens = self._perceiver.lens_of(frame)
        results, number = [], 1
        for target in self.targets:
            for detection in self._detections(target, frame, lens):
                result = _result(file, detection, target, lens, number)
                edges = partial(_edges, target.detector, frame, detection, lens)
                results.append(replace(result, find_edges=edges, mount=self._mount))
                number += len(detection.rejected)
        return PictureResult(file=file, frame=frame, targets=tuple(results))

    def measure_all(self, source: Source, file: str, note: Callable[[str], None]) -> Iterator[PictureResult]:
        """Measure the frames of an open source until they end, each with its number and time.

        Raises:
            CalibrationError: The frames have another aspect than the camera model.
            PictureError: A recording is damaged at this point.
        """
        began_s = None
        self._several.clear()
        for frame in source.frames(note):
            began_s = frame.captured_at_s if began_s is None else began_s
            time_s = frame.captured_at_s - began_s
            result = self._measure(frame, file)
            placed = (replace(each, frame=frame.sequence, time_s=time_s) for each in result.targets)
            yield replace(result, targets=tuple(placed))

    def _detections(self, target: NamedDetector, frame: Frame, lens: CameraModel) -> tuple[Detection, ...]:
        """Return every target that says which one it is, or the one that there is.

        Several of one kind have the names that they get in a run that begins with the first frame. Those that are not
        there are left out, unless their numbers say that each must be.
        """
        detector = target.detector
        if isinstance(detector, TracksSeveral) and target.members != (target.name,):
            several = self._several.setdefault(target.name, Several(target.members, detector))
            each = tuple(several.look(frame, lens, {}).values())
            seen = tuple(one for one in each if detector.numbers or one.status is not DetectionStatus.NOT_FOUND)
            return seen or each[:1]
        if isinstance(detector, FindsSeveral):
            return detector.detect_all(frame, lens=lens)
        return (detector.detect(frame, lens=lens),)

    def between(self, result: PictureResult, names: tuple[str, str]) -> Separation | None:
        """Measure how far apart two targets of a picture are; None unless both were measured in it."""
        if result.frame is None:
            return None
        seen = {each.measurement.target: each.seen for each in result.targets}
        one, other = (seen.get(name) for name in names)
        return separation(one, other, self._perceiver.lens_of(result.frame)) if one and other else None


def _edges(detector: Detector, frame: Frame, found: Detection, lens: CameraModel) -> Points:
    if found.is_whole and isinstance(detector, ShowsEdges):
        return detector.edge_points(frame, found, lens=lens)
    return no_points()


def _result(file: str, detection: Detection, target: NamedDetector, lens: CameraModel, number: int) -> TargetResult:
    shape = target.detector.target_shape
    by_size = measurement = measure(detection, shape, lens, 0.0)
    floor = None if target.footing is None else stand(by_size, detection, shape, lens, target.footing)
    if floor is not None:
        measurement = floor.measurement
    elif not math.isfinite(by_size.sigma_m or 0.0):
        measurement = unmeasured(by_size)
    seen = SeenTarget(detection=detection, measurement=by_size if floor is None else measurement, shape=shape)
    return TargetResult(
        file=file,
        measurement=measurement,
        detection=detection,
        has_corners=shape.has_corners,
        parts=sigma_parts(measurement if floor is None else by_size, shape, lens),
        rejected_from=number,
        direction_sigmas_rad=direction_sigmas_rad(seen, lens),
        seen=seen,
        floor=floor,
    )


def failed_results(file: str, targets: Sequence[NamedDetector], error: Exception) -> tuple[TargetResult, ...]:
    """Return results with status ``error`` and the reason."""
    reason = " ".join(str(error).split())
    return tuple(
        TargetResult(
            file=file,
            measurement=Measurement(
                target=target.name, status=MeasurementStatus.ERROR, captured_at_s=0.0, reason=reason
            ),
        )
        for target in targets
    )


def remedies_for(choice: DriverChoice, refused: Detection, frame: Frame, lens: CameraModel | None) -> list[Remedy]:
    """Return the changes with which something that was refused in a picture is accepted: one of each option at most.

    Args:
        lens: The lens at the picture's resolution, with which it was refused; None where it is not known.
    """
    (named,) = build_detectors([choice], lens)
    detector = named.detector
    if refused.status is not DetectionStatus.NOT_FOUND or not isinstance(detector, KnowsRemedies):
        return []
    helpful: dict[str, Remedy] = {}
    for remedy in detector.remedies() if refused.rejected else ():
        if remedy.key in helpful:
            continue
        changed = replace(choice, options=remedy.options)
        found = build_detectors([changed], lens)[0].detector.detect(frame, lens=lens)
        was_refused = any(math.dist(found.centre_px, each.centre_px) < each.size_px / 2 for each in refused.rejected)
        if found.status is DetectionStatus.FOUND and was_refused:
            helpful[remedy.key] = remedy
    return [*helpful.values()]


def remedy_notes(
    result: PictureResult, choices: Sequence[DriverChoice], camera_model: CameraModel, noted: set[str]
) -> Iterator[str]:
    """Yield a sentence for each target that would be found in a picture with other options.

    Args:
        noted: The targets with a note in an earlier picture; each gets one note.
    """
    refused = {each.measurement.target: each.detection for each in result.targets}
    for choice in choices:
        detection = refused.get(choice.name)
        if choice.name in noted or detection is None or result.frame is None:
            continue
        lens = camera_model.for_frame(result.frame)
        remedies = remedies_for(choice, detection, result.frame, lens)
        if remedies:
            noted.add(choice.name)
            yield f"{result.file}: {choice.name} is found with {' or '.join(map(str, remedies))}"
