"""The command ``measure``: how far away a target is in pictures."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.cli.exits import DONE, NOT_FOUND, WRONG, plain_errors
from stadimeter.cli.explanation import copy_paths, explanation, explanation_record, marks_of
from stadimeter.cli.formatting import METRE, LengthUnit, format_bearing, format_distance, format_tilt
from stadimeter.cli.target_options import ConfigOption, GivenTarget, WantedTargets, takes_target, wanted_targets
from stadimeter.config.camera_file import load_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.errors import ConfigError, PictureError, Problem
from stadimeter.workbench.annotation import annotate, write_picture
from stadimeter.workbench.measuring import PictureResult, TargetResult, measure_picture

if TYPE_CHECKING:
    from rich.progress import Progress

MANY_PICTURES = 5
"""More pictures than this have a progress bar, on a terminal."""

EXIT_CODES = {
    MeasurementStatus.MEASURED: DONE,
    MeasurementStatus.NOT_FOUND: NOT_FOUND,
    MeasurementStatus.TRUNCATED: NOT_FOUND,
    MeasurementStatus.ERROR: WRONG,
}


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(measure)


@takes_target
def measure(
    *,
    target: GivenTarget,
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE", help="Picture files.")],
    camera: Annotated[
        Path | None,
        typer.Option("--camera", metavar="FILE", help="The camera file, made by `stadimeter calibrate distance`."),
    ] = None,
    config: ConfigOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a line.")] = False,
    copies: Annotated[
        Path | None,
        typer.Option("--annotate", metavar="DIR", help="Write a copy of each picture there, with what was measured."),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option("--explain", help="Say how each result came about, and what was rejected and why."),
    ] = False,
) -> None:
    """Measure how far away a target is in pictures.

    Needs the target's size, and a camera file from `stadimeter calibrate distance` for the camera that took the
    pictures. A camera file fits every resolution of the same aspect.

    Prints one line for each picture: the distance, which is the length of the straight line from the camera to the
    target's centre, with its standard deviation. A target that is cut off by the border of the picture has no size, so
    it has no distance.

    With --json, each line is an object with file, target, status (measured, not_found, truncated or error),
    distance_m, depth_m, sigma_m, bearing_rad (positive to the right), elevation_rad (positive upwards), tilt_rad (of
    something flat, 0 for face on), ambiguity (0 if the tilt is certain, 1 if it may as well be the other way) and
    reason.

    With --explain, each line is followed by what was seen and how sharply, what the standard deviation is made up of,
    and what was looked at but rejected: where it is, how large, and the test that it failed. With --json as further
    fields, among them rejected, a list of objects; with --annotate drawn into the copies under the same numbers.

    **Examples**

    - `stadimeter measure 3ft.png 4ft.png --camera camera.toml --sheet 11in,8.5in`

    - `stadimeter measure shots/*.jpg --camera camera.toml --ball 6.4cm --hsv "29,86,6:64,255,255" --json`

    - `stadimeter measure shots/*.jpg --config config/follow-ball.toml --annotate annotated`

    - `stadimeter measure dark.jpg --camera camera.toml --tag 8cm --family 36h11 --explain`

    **Exit code**: 0 everything was measured; 1 a target was not found, or cut off; 2 an option, a file or a
    picture is wrong. A bad picture does not stop the others.
    """
    with plain_errors():
        wanted = wanted_targets(target, config)
        camera_model = _camera_model(camera, wanted)
        targets = build_detectors(wanted.choices, camera_model)
        printer = _json_printer(explain=explain) if as_json else _line_printer(images, wanted, explain=explain)
        paths = copy_paths(images, copies)
        codes = [
            _one(image, targets, camera_model, printer, _Copy.of(paths.get(image), wanted.unit, explain=explain))
            for image in _counted(images)
        ]
    raise typer.Exit(max(codes))


def _camera_model(file: Path | None, wanted: WantedTargets) -> CameraModel:
    if file is not None:
        return load_camera_model(file)
    if wanted.camera_model is not None:
        return wanted.camera_model
    hint = "make one with `stadimeter calibrate distance PICTURE@DISTANCE -o FILE`"
    raise ConfigError(
        [Problem("the camera file is missing; without it pixels say nothing about metres", key="--camera", hint=hint)]
    )


Printer = Callable[[TargetResult], None]


def _one(
    image: Path,
    targets: Sequence[NamedDetector],
    camera_model: CameraModel,
    printer: Printer,
    copy: _Copy | None,
) -> int:
    """Measure one picture, print what was found, write its copy, and return the exit code that it asks for."""
    result = measure_picture(image, targets, camera_model)
    for each in result.targets:
        printer(each)
    code = max(EXIT_CODES[each.measurement.status] for each in result.targets)
    return max(code, _write_copy(result, copy)) if copy else code


@dataclass(frozen=True, slots=True, kw_only=True)
class _Copy:
    """A copy of a picture to be written: where to, and what it says."""

    path: Path
    unit: LengthUnit
    explain: bool

    @classmethod
    def of(cls, path: Path | None, unit: LengthUnit, *, explain: bool) -> _Copy | None:
        return None if path is None else cls(path=path, unit=unit, explain=explain)


def _write_copy(result: PictureResult, copy: _Copy) -> int:
    if result.frame is None:
        return DONE
    try:
        write_picture(copy.path, annotate(result.frame.image, marks_of(result, copy.unit, explain=copy.explain)))
    except PictureError as error:
        typer.echo(f"error: {error}", err=True)
        return WRONG
    return DONE


def _json_printer(*, explain: bool) -> Printer:
    def print_record(result: TargetResult) -> None:
        further = explanation_record(result) if explain else {}
        typer.echo(json.dumps({**result.record(), **further}))
        _tell_error(result)

    return print_record


def _line_printer(images: Sequence[Path], wanted: WantedTargets, *, explain: bool) -> Printer:
    file_width = max(len(str(image)) for image in images)
    target_width = max(len(choice.name) for choice in wanted.choices)

    def print_line(result: TargetResult) -> None:
        if not _tell_error(result):
            head = f"{result.file:<{file_width}}  {result.measurement.target:<{target_width}}"
            typer.echo(f"{head}  {_in_words(result, wanted.unit)}")
            for line in explanation(result) if explain else ():
                typer.echo(line)

    return print_line


def _tell_error(result: TargetResult) -> bool:
    """Tell a bad picture on standard error; return whether it is one."""
    is_error = result.measurement.status is MeasurementStatus.ERROR
    if is_error:
        reason = result.measurement.reason
        where = "" if result.file in reason else f"{result.file}: "
        typer.echo(f"error: {where}{reason}", err=True)
    return is_error


def _in_words(result: TargetResult, unit: LengthUnit) -> str:
    measured = result.measurement
    if measured.status is not MeasurementStatus.MEASURED:
        status = "truncated" if measured.status is MeasurementStatus.TRUNCATED else "not found"
        return f"{status}: {measured.reason}"
    in_metres = format_distance(measured.distance_m, measured.sigma_m, METRE)
    first = "" if unit is METRE else f"{format_distance(measured.distance_m, measured.sigma_m, unit):<16}"
    depth = format_distance(measured.depth_m, measured.sigma_m, unit)
    whereabouts = f"{format_bearing(measured.bearing_rad):<11}{format_tilt(measured.tilt_rad)}".rstrip()
    return f"{first}{in_metres:<18}depth {depth:<18}{whereabouts}"


def _counted(images: Sequence[Path]) -> Iterator[Path]:
    """Yield the pictures, with a progress bar if there are many and standard error is a terminal."""
    if len(images) <= MANY_PICTURES or not sys.stderr.isatty():
        yield from images
        return
    with _progress() as progress:
        task = progress.add_task("measuring", total=len(images))
        for image in images:
            yield image
            progress.advance(task)


@contextmanager
def _progress() -> Iterator[Progress]:
    # Few pictures need no bar, and a start without it is shorter.
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # Lines printed meanwhile go above the bar where both share a terminal; elsewhere they must stay on standard output.
    shared = sys.stdout.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=shared) as progress:
        yield progress
