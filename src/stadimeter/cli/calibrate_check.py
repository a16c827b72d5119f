"""The command ``calibrate check``: how wrong a camera file is, from new pictures at known distances."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors
from stadimeter.cli.formatting import LengthUnit, format_distance
from stadimeter.cli.known_pictures import DistanceErrorOption, PicturesAtDistances, look_at
from stadimeter.cli.target_options import GivenTarget, takes_target, wanted_targets
from stadimeter.config.camera_file import load_camera_model
from stadimeter.ranging.calibration_check import CalibrationCheck, check_calibration


def register(app: typer.Typer) -> None:
    """Add the command to the group ``calibrate``."""
    app.command("check")(check)


@takes_target
def check(
    *,
    target: GivenTarget,
    pictures: PicturesAtDistances,
    camera: Annotated[Path, typer.Option("--camera", metavar="FILE", help="The camera file to check.")],
    distance_error: DistanceErrorOption = 1.0,
) -> None:
    """Show how wrong a camera file is, from new pictures of a target at known distances.

    Take the pictures as for `calibrate distance`, but not the same ones. Each error is given in per cent, and in
    standard deviations of what the camera file, the picture and the tape together allow.

    **Example**

    - `stadimeter calibrate check 3ft.png@36in 4ft.png@48in --camera camera.toml --sheet 11in,8.5in`

    **Exit code**: 0 all errors are within what is stated; 1 they are not, or the target was not found in a picture; 2
    an option, a file or a picture is wrong.
    """
    with plain_errors():
        wanted = wanted_targets(target)
        model = load_camera_model(camera)
        known = look_at(pictures, wanted, model)
        if not known.usable:
            typer.echo("error: no picture can be used, so nothing was checked", err=True)
            raise typer.Exit(NOT_FOUND)
        checked = check_calibration(known.usable, model, distance_relative_sigma=distance_error / 100)
        _tell(checked, wanted.unit)
        typer.echo(_verdict(checked, camera))
    raise typer.Exit(DONE if checked.is_sound and known.all_usable else NOT_FOUND)


def _tell(checked: CalibrationCheck, unit: LengthUnit) -> None:
    name_width = max(len(each.picture) for each in checked.pictures)
    for each in checked.pictures:
        measured = format_distance(each.measured_m, None, unit)
        typer.echo(
            f"{each.picture:<{name_width}}  {measured} instead of {format_distance(each.depth_m, None, unit)}:  "
            f"{each.error_share:+.2%}, {abs(each.sigmas):.1f} σ{'  outside' if each.is_outside else ''}"
        )
    typer.echo(f"mean error {checked.bias_share:+.2%} ± {checked.bias_sigma_share:.2%}")


def _verdict(checked: CalibrationCheck, camera: Path) -> str:
    if checked.bias_is_outside:
        how = "far" if checked.bias_share > 0 else "near"
        return (
            f"{camera} is wrong: it reads {abs(checked.bias_share):.1%} too {how}, more than it states; calibrate "
            "again, and check the target's size and the distances"
        )
    if not checked.is_sound:
        worst = max(checked.pictures, key=lambda each: abs(each.sigmas))
        return (
            f"{camera} fits on the whole, but not {worst.picture}: check its distance, and that nothing is in the way"
        )
    return f"{camera} is right within what it states"
