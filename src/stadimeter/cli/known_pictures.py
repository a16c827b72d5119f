"""Pictures at known distances on the command line, which two of the commands that calibrate have in common."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.app.detectors import build_detectors
from stadimeter.cli.target_options import WantedTargets, parse_known_length
from stadimeter.core.camera_model import CameraModel, ToneCurve
from stadimeter.core.detection import DetectionStatus
from stadimeter.errors import ConfigError
from stadimeter.ranging.calibration import KnownDistance
from stadimeter.workbench.calibration.calibrating import check_lens_settings
from stadimeter.workbench.calibration.distance_fit import look_at_distance, remedy_words
from stadimeter.workbench.colour_profile import profile_notes
from stadimeter.workbench.measuring import open_picture

_PATH_AT_DISTANCE = typer.Argument(
    metavar="PATH@DISTANCE", help="Pictures of the target at known distances: 2ft.png@24in."
)
PicturesAtDistances = Annotated[list[str], _PATH_AT_DISTANCE]
MaybePicturesAtDistances = Annotated[list[str] | None, _PATH_AT_DISTANCE]
DistanceErrorOption = Annotated[
    float,
    typer.Option(
        "--distance-error",
        metavar="PERCENT",
        min=0.0,
        max=50.0,
        help="How well you know the distances: one standard deviation, in per cent of each.",
    ),
]
ToneCurveOption = Annotated[
    ToneCurve,
    typer.Option(
        "--tone-curve",
        help="How the camera's values follow from light: srgb for nearly every camera, linear for raw pictures, whose "
        "values are in proportion to it.",
    ),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownPictures:
    """Pictures in which the target was found whole, and whether those are all."""

    usable: tuple[KnownDistance, ...]
    all_usable: bool


def look_at(pictures: Sequence[str], wanted: WantedTargets, camera_model: CameraModel | None) -> KnownPictures:
    """Look for the target in ``PATH@DISTANCE`` pictures; say on standard error which cannot be used, and why.

    Raises `StadimeterError` if a distance or a picture is wrong, or the zoom differs.
    """
    taken = [_split(each) for each in pictures]
    _refuse_twice([path for path, _ in taken])
    paths = [path for path, _ in taken]
    for note in (*check_lens_settings(paths), *profile_notes(paths)):
        typer.echo(f"note: {note}", err=True)
    (target,) = build_detectors(wanted.choices, camera_model)
    known = [look_at_distance(str(path), open_picture(path), depth_m, target, camera_model) for path, depth_m in taken]
    usable = tuple(each for each in known if each.detection.status is DetectionStatus.FOUND)
    for each in known:
        if each.detection.status is not DetectionStatus.FOUND:
            remedy = remedy_words(each, open_picture(Path(each.picture)), wanted.choices[0], camera_model)
            typer.echo(f"left out: {each.picture}: {each.detection.reason}{remedy}", err=True)
        elif each.detection.reason:
            typer.echo(f"note: {each.picture}: {each.detection.reason}", err=True)
    return KnownPictures(usable=usable, all_usable=len(usable) == len(known))


def today() -> str:
    """Return the date of today, as ISO 8601 has it."""
    return dt.datetime.now().astimezone().date().isoformat()


def _refuse_twice(paths: Sequence[Path]) -> None:
    for number, path in enumerate(paths):
        if path in paths[:number]:
            raise ConfigError(f"{path} is given twice; a picture says the same each time, so give each of them once")


def _split(text: str) -> tuple[Path, float]:
    path, at, length = text.rpartition("@")
    if not (at and path):
        raise ConfigError(f"{text!r} does not say how far away the target is; write it such as 2ft.png@24in")
    return Path(path), parse_known_length(length, path)
