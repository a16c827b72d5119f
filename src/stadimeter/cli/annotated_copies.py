"""What annotated copies say, and what their files are called."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from stadimeter.cli.formatting import METRE, LengthUnit, format_distance, format_tilt
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.annotation import Mark
from stadimeter.workbench.measuring import PictureResult, TargetResult

KEPT_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}
"""A copy is of the same kind as the picture where that is one of these, else a PNG."""

_WORDS = {
    MeasurementStatus.NOT_FOUND: "not found",
    MeasurementStatus.TRUNCATED: "cut off by the border",
    MeasurementStatus.ERROR: "no measurement",
}


def copy_paths(images: Sequence[Path], folder: Path | None) -> dict[Path, Path]:
    """Choose a file for the copy of each picture; two pictures of the same name get two.

    No copy has the name of its picture, so that the folder may be the pictures' own.

    Args:
        folder: Where to; it is made if it is not there. None for no copies.

    Raises:
        ConfigError: The folder cannot be made.
    """
    if folder is None:
        return {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ConfigError([Problem(f"the folder {folder} cannot be made: {reason}", key="--annotate")]) from error
    paths: dict[Path, Path] = {}
    for image in dict.fromkeys(images):
        suffix = image.suffix if image.suffix.lower() in KEPT_SUFFIXES else ".png"
        taken = set(paths.values()) | set(images)
        names = (
            f"{image.stem}-measured{number}{suffix}" for number in ("", *(f"-{n}" for n in range(2, len(images) + 3)))
        )
        paths[image] = next(folder / name for name in names if folder / name not in taken)
    return paths


def marks_of(result: PictureResult, unit: LengthUnit, *, explain: bool = False) -> tuple[Mark, ...]:
    """Return what to draw into the copy of a picture.

    Args:
        unit: The unit of the headlines.
        explain: Whether to draw what was looked at and rejected as well.
    """
    marks = (_mark(each, unit) for each in result.targets)
    if not explain:
        return tuple(marks)
    return tuple(replace(mark, rejected=each.rejected) for mark, each in zip(marks, result.targets, strict=True))


def _mark(result: TargetResult, unit: LengthUnit) -> Mark:
    measured = result.measurement
    detection = result.detection or Detection(target=measured.target, status=DetectionStatus.NOT_FOUND)
    if measured.status is not MeasurementStatus.MEASURED:
        words = _WORDS[measured.status]
        return Mark(
            detection=detection,
            has_corners=result.has_corners,
            headline=words,
            lines=(f"{measured.target}: {words}", measured.reason),
        )
    return Mark(
        detection=detection,
        has_corners=result.has_corners,
        headline=format_distance(measured.distance_m, measured.sigma_m, unit),
        lines=_legend(measured, detection, unit),
    )


def _legend(measured: Measurement, detection: Detection, unit: LengthUnit) -> tuple[str, ...]:
    distance = format_distance(measured.distance_m, measured.sigma_m, unit)
    in_metres = "" if unit is METRE else f"  =  {format_distance(measured.distance_m, measured.sigma_m, METRE)}"
    depth = format_distance(measured.depth_m, measured.sigma_m, unit)
    direction = f"{_angle(measured.bearing_rad, 'right', 'left')}, {_angle(measured.elevation_rad, 'up', 'down')}"
    tilt = "" if measured.tilt_rad is None else f", {format_tilt(measured.tilt_rad).replace('°', ' deg')}"
    return (
        f"{measured.target}: {distance}{in_metres}",
        f"depth {depth}, {direction}{tilt}",
        f"{detection.width_px:.1f} x {detection.height_px:.1f} px ± {detection.size_sigma_px:.2f}",
    )


def _angle(angle_rad: float | None, positive: str, negative: str) -> str:
    degrees = math.degrees(angle_rad or 0.0)
    return f"{abs(degrees):.1f} deg {positive if degrees >= 0 else negative}"
