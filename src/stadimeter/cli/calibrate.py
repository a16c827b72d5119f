"""The commands that calibrate a camera."""

from __future__ import annotations

import datetime as dt
import math
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.app.measuring import NamedDetector, build_detectors, open_picture
from stadimeter.cli.exits import DONE, NOT_FOUND, told_plainly
from stadimeter.cli.formatting import LengthUnit, format_distance
from stadimeter.cli.target_options import (
    BallOption,
    HsvOption,
    KnownSideOption,
    SheetOption,
    parse_known_length,
    wanted_targets,
)
from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.detection import DetectionStatus
from stadimeter.errors import ConfigError
from stadimeter.ranging.calibration import Calibration, KnownDistance, calibrate

FAR_OFF_AXIS_RAD = math.radians(10)
"""Further from the middle of the picture than this, depth and straight line differ by more than 1.5 %."""

calibrate_app = typer.Typer(
    name="calibrate", no_args_is_help=True, help="Find out a camera's focal length, and write its camera file."
)


def register(app: typer.Typer) -> None:
    """Add the commands to the command line.

    Args:
        app: The command line.
    """
    app.add_typer(calibrate_app)


@calibrate_app.callback()
def _calibrate() -> None:
    """Find out a camera's focal length, and write its camera file."""


@calibrate_app.command("distance")
def distance(
    pictures: Annotated[
        list[str],
        typer.Argument(metavar="PATH@DISTANCE...", help="Pictures of the target at known distances: 2ft.png@24in."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The camera file to write.")],
    sheet: SheetOption = None,
    known_side: KnownSideOption = "auto",
    ball: BallOption = None,
    hsv: HsvOption = None,
    distance_error: Annotated[
        float,
        typer.Option(
            "--distance-error",
            metavar="PERCENT",
            min=0.0,
            max=50.0,
            help="How well you know the distances: one standard deviation, in per cent of each.",
        ),
    ] = 1.0,
) -> None:
    """Calibrate a camera from pictures of a target at known distances.

    Take a picture of a sheet of paper or a ball of known size in the middle of the picture, the sheet facing the
    camera, and measure with a tape how far it is from the lens. DISTANCE is the depth, along the direction in which the
    camera looks; in the middle of the picture that is the straight line. One picture is enough; several, at different
    distances, are better: how far they differ shows how sure the focal length is.

    Then `stadimeter measure` and `stadimeter run` need the camera file, and pictures from the same camera at any
    resolution of the same aspect, with the same zoom. An existing file is replaced.

    **Examples**

    - `stadimeter calibrate distance 2ft.png@24in --sheet 11in,8.5in -o camera.toml`

    - `stadimeter calibrate distance a.jpg@50cm b.jpg@1m --ball 6.4cm --hsv "29,86,6:64,255,255" -o camera.toml`

    **Exit code**: 0 the camera file was written from all pictures; 1 the target was not found in some, which
    were left out, or in all, and then nothing was written; 2 an option, a file or a picture is wrong, and nothing was
    written.
    """
    with told_plainly():
        wanted = wanted_targets(sheet=sheet, known_side=known_side, ball=ball, hsv=hsv)
        taken = [_split(each) for each in pictures]
        (target,) = build_detectors(wanted.choices, None)
        known = [_known(path, depth_m, target) for path, depth_m in taken]
        for each in known:
            _tell_if_unusable(each)
        usable = [each for each in known if each.detection.status is DetectionStatus.FOUND]
        if not usable:
            typer.echo("error: no picture can be used, so nothing was written", err=True)
            raise typer.Exit(NOT_FOUND)
        made = calibrate(usable, date=_today(), distance_relative_sigma=distance_error / 100)
        replaced = output.exists()
        save_camera_model(output, made.camera_model)
        _tell(made, wanted.unit)
        typer.echo(f"{'replaced' if replaced else 'wrote'} {output}")
    raise typer.Exit(DONE if len(usable) == len(known) else NOT_FOUND)


def _split(text: str) -> tuple[Path, float]:
    path, at, length = text.rpartition("@")
    if not (at and path):
        raise ConfigError(f"{text!r} does not say how far away the target is; write it such as 2ft.png@24in")
    return Path(path), parse_known_length(length, path)


def _known(path: Path, depth_m: float, target: NamedDetector) -> KnownDistance:
    frame = open_picture(path)
    return KnownDistance(
        picture=str(path),
        width_px=frame.width_px,
        height_px=frame.height_px,
        detection=target.detector.detect(frame),
        size=target.detector.target_size,
        depth_m=depth_m,
    )


def _tell_if_unusable(known: KnownDistance) -> None:
    if known.detection.status is not DetectionStatus.FOUND:
        typer.echo(f"left out: {known.picture}: {known.detection.reason}", err=True)


def _tell(made: Calibration, unit: LengthUnit) -> None:
    name_width = max(len(each.picture) for each in made.pictures)
    for each in made.pictures:
        away = format_distance(each.depth_m, None, unit)
        size = format_distance(each.size_m, None, unit)
        typer.echo(
            f"{each.picture:<{name_width}}  {each.side} of {size} appears {each.apparent_px:.1f} px at {away}:  "
            f"focal length {each.focal_px:.1f} px ± {each.focal_px * each.relative_sigma:.1f}"
        )
        if each.off_axis_rad > FAR_OFF_AXIS_RAD:
            typer.echo(
                f"note: {each.picture}: the target is {math.degrees(each.off_axis_rad):.0f}° from the middle of the "
                f"picture; {away} was taken as its depth, so the straight line to it is longer",
                err=True,
            )
    model = made.camera_model
    share = model.focal_relative_sigma
    typer.echo(
        f"focal length {model.fx_px:.1f} px ± {model.fx_px * share:.1f} ({share:.1%}) "
        f"for pictures of {model.width_px}x{model.height_px}"
    )


def _today() -> str:
    return dt.datetime.now().astimezone().date().isoformat()
