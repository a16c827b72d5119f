"""The group of commands ``calibrate``: a camera file from known distances, and how wrong one is.

``calibrate board``, ``calibrate floor``, ``calibrate size`` and ``calibrate stereo`` have files of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from stadimeter.cli.calibrate_board import board
from stadimeter.cli.calibrate_floor import floor
from stadimeter.cli.calibrate_size import size
from stadimeter.cli.calibrate_stereo import stereo
from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, say_note
from stadimeter.cli.formatting import LengthUnit, format_distance
from stadimeter.cli.known_pictures import (
    AtOption,
    DistanceErrorOption,
    MaybePicturesAtDistances,
    PerhapsOption,
    PicturesAtDistances,
    ToneCurveOption,
    calibrate_live,
    look_at,
)
from stadimeter.cli.target_options import GivenTarget, LiveOption, WantedTargets, takes_target, targets_from_options
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.core.camera_model import ToneCurve
from stadimeter.errors import ConfigError, Problem
from stadimeter.ranging.calibration import Calibration, FocalLength
from stadimeter.ranging.calibration_check import CalibrationCheck, check_calibration
from stadimeter.workbench.calibration.board_session import today
from stadimeter.workbench.calibration.distance_fit import fit_distances, remedy_words
from stadimeter.workbench.measuring import open_picture

calibrate = typer.Typer(no_args_is_help=True)


@calibrate.callback()
def _calibrate() -> None:
    """Find out a camera's focal length, write its camera file, and check it; or how large a thing is."""


# Further from the middle of the picture than this, depth and straight line differ by more than 1.5 %.
FAR_OFF_AXIS_RAD = math.radians(10)


@calibrate.command("distance")
@takes_target
def distance(
    *,
    target: GivenTarget,
    pictures: MaybePicturesAtDistances = None,
    live: LiveOption = None,
    at: AtOption = None,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The camera file to write.")],
    distance_error: DistanceErrorOption = 1.0,
    tone_curve: ToneCurveOption = "srgb",
    perhaps: PerhapsOption = False,
) -> None:
    """Calibrate a camera from pictures of a target at known distances.

    Take a picture of a sheet of paper or a ball of known size in the middle of the picture, the sheet facing the
    camera, and measure with a tape how far it is from the lens. DISTANCE is the depth, along the direction in which the
    camera looks; in the middle of the picture that is the straight line. One picture is enough; several, at different
    distances, are better: how far they differ shows how sure the focal length is, and from near and far ones the edge
    bias is found as well, by how much every edge is seen too far out.

    What is only perhaps the target calibrates nothing: look at it with `stadimeter measure --annotate`, and give
    --perhaps if it is the target.

    Pictures of a raw or scientific camera, whose values are in proportion to light, need --tone-curve linear, which the
    camera file then holds. Through the wrong curve each edge is off by some tenths of a pixel.

    With --live the program takes the pictures itself: it asks for the target at one distance, takes several frames,
    then asks for it at another one, which proves the first. Here a distance is measured from the lens to the target's
    nearest point. If the distances contradict each other by more than --distance-error allows, nothing is written.

    Then `stadimeter measure` and `stadimeter run` need the camera file, and pictures from the same camera at any
    resolution of the same aspect, with the same zoom. An existing file is replaced.

    **Examples**

    - `stadimeter calibrate distance 2ft.png@24in --sheet 11in,8.5in -o camera.toml`

    - `stadimeter calibrate distance a.jpg@50cm b.jpg@1m --ball 6.4cm --hsv "29,86,6:64,255,255" -o camera.toml`

    - `stadimeter calibrate distance --live opencv,device=0 --ball 6.4cm --hsv "29,86,6:64,255,255" -o camera.toml`

    **Exit code**: 0 the camera file was written from all pictures; 1 some were left out, since the target was not
    found in them or they contradict the others, or all, and then nothing was written; 2 an option, a file or a picture
    is wrong, or distances contradict each other and the others do not tell which is wrong, and nothing was written.
    """
    with plain_errors():
        if bool(pictures) == bool(live):
            raise ConfigError("give pictures at known distances, or --live for a camera, one of the two")
        if at and not live:
            raise ConfigError("--at says where to put the target before a camera; give --live with it")
        if perhaps and live:
            raise ConfigError("--perhaps says that a picture was looked at; before a camera move nearer, or add light")
        wanted = targets_from_options(target)
        if live:
            if not output.parent.is_dir():  # known before the person walks to and fro, not after it
                raise ConfigError([Problem(f"there is no folder {output.parent} for {output.name}", key="-o")])
            made = calibrate_live(
                live, at or [], wanted, distance_relative_sigma=distance_error / 100, tone_curve=tone_curve
            )
            all_found = True
        else:
            made, all_found = _from_pictures(
                pictures or [], wanted, distance_error / 100, tone_curve, takes_perhaps=perhaps
            )
        replaced = output.exists()
        save_camera_model(output, made.camera_model)
        _tell(made, wanted.unit)
        typer.echo(f"{'replaced' if replaced else 'wrote'} {output}")
    raise typer.Exit(DONE if all_found else NOT_FOUND)


def _from_pictures(
    pictures: Sequence[str],
    wanted: WantedTargets,
    distance_relative_sigma: float,
    tone_curve: ToneCurve,
    *,
    takes_perhaps: bool,
) -> tuple[Calibration, bool]:
    """Calibrate; return the calibration, and whether it comes from all pictures."""
    known = look_at(pictures, wanted, None, takes_perhaps=takes_perhaps)
    if not known.usable:
        _nothing_written()
    fit = fit_distances(
        known.usable,
        lambda name: open_picture(Path(name)),
        wanted.choices,
        date=today(),
        distance_relative_sigma=distance_relative_sigma,
        tone_curve=tone_curve,
    )
    for each in fit.left_out:
        remedy = remedy_words(each, open_picture(Path(each.picture)), wanted.choices[0])
        reason = f"through the camera file it is not found: {each.detection.reason}{remedy}"
        typer.echo(f"left out: {each.picture}: {reason}", err=True)
    for words in fit.outlier_words:
        typer.echo(words, err=True)
    for each in fit.elsewhere:
        there = f"{each.detection.centre_px[0]:.0f}, {each.detection.centre_px[1]:.0f} px"
        say_note(f"{each.picture}: the target is taken to be at {there}; check it with `stadimeter measure --annotate`")
    if fit.calibration is None:
        _nothing_written()
    return fit.calibration, known.all_usable and not (fit.left_out or fit.outliers)


def _nothing_written() -> NoReturn:
    typer.echo("error: no picture can be used, so nothing was written", err=True)
    raise typer.Exit(NOT_FOUND)


def _tell(made: Calibration, unit: LengthUnit) -> None:
    name_width = max(len(each.picture) for each in made.pictures)
    for each in made.pictures:
        _tell_picture(each, name_width, unit)
    model = made.camera_model
    share = model.focal_relative_sigma
    typer.echo(
        f"focal length {model.fx_px:.1f} px ± {model.fx_px * share:.1f} ({share:.1%}) "
        f"for pictures of {model.width_px}x{model.height_px}"
    )
    if made.fit.bias_was_fitted:
        typer.echo(f"edge bias {made.fit.edge_bias_px:+.2f} px ± {made.fit.edge_bias_sigma_px:.2f}")
    elif len(made.pictures) > 1:
        typer.echo(f"edge bias taken as 0: {_why_no_bias(made, unit)}")


def _tell_picture(each: FocalLength, name_width: int, unit: LengthUnit) -> None:
    away = format_distance(each.depth_m, None, unit)
    typer.echo(
        f"{each.picture:<{name_width}}  {each.width_px:.1f} x {each.height_px:.1f} px at {away}:  "
        f"focal length {each.focal_px:.1f} px ± {each.focal_px * each.relative_sigma:.1f}; the camera file "
        f"{each.reads}"
    )
    if each.off_axis_rad > FAR_OFF_AXIS_RAD:
        say_note(
            f"{each.picture}: the target is {math.degrees(each.off_axis_rad):.0f}° from the middle of the "
            f"picture; {away} was taken as its depth, so the straight line to it is longer"
        )


def _why_no_bias(made: Calibration, unit: LengthUnit) -> str:
    if made.one_distance:
        why = "all pictures are at one distance, where it looks like another focal length"
    elif math.isinf(made.fit.edge_bias_sigma_px):
        return "what this detector sees does not tell it"
    else:
        why = f"these distances tell it only within ± {made.fit.edge_bias_sigma_px:.1f} px"
    if made.one_distance and made.more_at_m is None:
        return f"{why}; add one that is several times as far away"
    if made.more_at_m is None:
        return f"{why}; to tell it, measure the distances better and say so with --distance-error"
    return f"{why}; one more picture at {format_distance(made.more_at_m, None, unit)} or farther would tell it"


calibrate.command("board")(board)
calibrate.command("stereo")(stereo)
calibrate.command("floor")(floor)
calibrate.command("size")(takes_target(size))


@calibrate.command("check")
@takes_target
def check(
    *,
    target: GivenTarget,
    pictures: PicturesAtDistances,
    camera: Annotated[Path, typer.Option("--camera", metavar="FILE", help="The camera file to check.")],
    distance_error: DistanceErrorOption = 1.0,
    perhaps: PerhapsOption = False,
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
        wanted = targets_from_options(target)
        model = load_camera_model(camera)
        known = look_at(pictures, wanted, model, takes_perhaps=perhaps)
        if not known.usable:
            typer.echo("error: no picture can be used, so nothing was checked", err=True)
            raise typer.Exit(NOT_FOUND)
        checked = check_calibration(known.usable, model, distance_relative_sigma=distance_error / 100)
        _tell_check(checked, wanted.unit)
        typer.echo(_verdict(checked, camera))
    raise typer.Exit(DONE if checked.is_sound and known.all_usable else NOT_FOUND)


def _tell_check(checked: CalibrationCheck, unit: LengthUnit) -> None:
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
