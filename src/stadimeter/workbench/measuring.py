"""Measuring targets in picture files, one after the other: a bad picture does not stop the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stadimeter.app.clock import SteppedClock
from stadimeter.app.detectors import NamedDetector
from stadimeter.cameras.protocol import Camera
from stadimeter.config.plugins import CAMERAS, DriverContext, load_plugin
from stadimeter.config.untrusted_file import open_untrusted
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, RejectedCandidate
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.errors import PictureError, StadimeterError, UnreadableError
from stadimeter.perception.perceiver import Perceiver
from stadimeter.ranging.measure import SigmaParts, sigma_parts


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TargetResult:
    """Result for one target in one picture.

    Attributes:
        detection: Where the target is; None if the picture could not be read.
        parts: What the standard deviation is made up of; None without a distance.
        rejected_from: The number of the first of the candidates that were rejected. They are counted through all
            targets of a picture, so that a number means one place in it.
    """

    file: str
    measurement: Measurement
    detection: Detection | None = None
    has_corners: bool = False
    parts: SigmaParts | None = None
    rejected_from: int = 1

    @property
    def rejected(self) -> tuple[tuple[int, RejectedCandidate], ...]:
        """Rejected candidates, each with its number."""
        candidates = self.detection.rejected if self.detection else ()
        return tuple(enumerate(candidates, start=self.rejected_from))

    def record(self) -> dict[str, str | float | None]:
        """Return the result as the object that ``--json`` prints: lengths in metres, angles in radians."""
        measured = self.measurement
        return {
            "file": self.file,
            "target": measured.target,
            "status": measured.status.value,
            "distance_m": measured.distance_m,
            "depth_m": measured.depth_m,
            "sigma_m": measured.sigma_m,
            "bearing_rad": measured.bearing_rad,
            "elevation_rad": measured.elevation_rad,
            "tilt_rad": measured.tilt_rad,
            "ambiguity": measured.ambiguity,
            "reason": measured.reason,
        }


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PictureResult:
    """Results of one picture; without a frame it could not be read."""

    file: str
    frame: Frame | None
    targets: tuple[TargetResult, ...]


def open_picture(path: Path) -> Frame:
    """Read a picture file through the ``images`` camera.

    Raises:
        PictureError: It is missing, a folder, empty, damaged, or not a picture.
    """
    try:  # the camera takes folders and patterns, too
        open_untrusted(path).close()
    except UnreadableError as error:
        raise PictureError(f"the picture {path} cannot be read: {error.reason}") from error
    plugin = load_plugin(CAMERAS, "images")
    camera: Camera = plugin.build(
        plugin.options.model_validate({"paths": [str(path)]}), DriverContext(name="pictures", clock=SteppedClock())
    )
    camera.open()
    try:
        return camera.read()
    finally:
        camera.close()


def measure_picture(path: Path, targets: Sequence[NamedDetector], camera_model: CameraModel) -> PictureResult:
    """Measure every target in a picture file.

    Args:
        camera_model: The lens, at any resolution of the pictures' aspect.

    Returns:
        One result for each target. Where the picture cannot be read, or has another aspect than the camera model, the
        status is ``error`` and the reason says why.
    """
    perceiver = Perceiver({each.name: each.detector for each in targets}, camera_model)
    frame = None
    try:
        frame = open_picture(path)
        detections, measurements = perceiver.look(frame)
    except StadimeterError as error:
        return PictureResult(file=str(path), frame=frame, targets=_failed(path, targets, error))
    results, number = [], 1
    for target, detection, measurement in zip(targets, detections, measurements, strict=True):
        shape = target.detector.target_shape
        results.append(
            TargetResult(
                file=str(path),
                measurement=measurement,
                detection=detection,
                has_corners=shape.has_corners,
                parts=sigma_parts(measurement, shape, camera_model),
                rejected_from=number,
            )
        )
        number += len(detection.rejected)
    return PictureResult(file=str(path), frame=frame, targets=tuple(results))


def _failed(path: Path, targets: Sequence[NamedDetector], error: Exception) -> tuple[TargetResult, ...]:
    reason = " ".join(str(error).split())
    return tuple(
        TargetResult(
            file=str(path),
            measurement=Measurement(
                target=target.name, status=MeasurementStatus.ERROR, captured_at_s=0.0, reason=reason
            ),
        )
        for target in targets
    )
