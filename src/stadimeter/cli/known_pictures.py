"""Pictures of a target at known distances for `calibrate`: from files, or taken with the person's help (``--live``)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.cli.exits import NOT_FOUND, say_note
from stadimeter.cli.formatting import FOOT, INCH, METRE, LengthUnit, format_distance
from stadimeter.cli.target_options import WantedTargets, camera_choice, parse_known_length
from stadimeter.core.camera_model import CameraModel, ToneCurve
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.calibration import Calibration, KnownDistance
from stadimeter.workbench.calibration.board_session import today
from stadimeter.workbench.calibration.live_distance import APART_MIN, LiveDistance, Take, look_at_distance, remedy_words
from stadimeter.workbench.frame_source import open_camera
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.picture_metadata import check_lens_settings, profile_notes

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


PerhapsOption = Annotated[
    bool, typer.Option("--perhaps", help="Take what is perhaps the target, too: you have looked at it.")
]


class KnownPictures(Struct, frozen=True, kw_only=True):
    """Pictures in which the target was found whole, and whether those are all."""

    usable: tuple[KnownDistance, ...]
    all_usable: bool


def look_at(
    pictures: Sequence[str], wanted: WantedTargets, camera_model: CameraModel | None, *, takes_perhaps: bool = False
) -> KnownPictures:
    """Look for the target in ``PATH@DISTANCE`` pictures; say on standard error which cannot be used, and why.

    Args:
        takes_perhaps: Whether a person says that what is perhaps the target is it.

    Raises `StadimeterError` if a distance or a picture is wrong, or the zoom differs.
    """
    taken = [_split(each) for each in pictures]
    refuse_twice([path for path, _ in taken])
    paths = [path for path, _ in taken]
    for note in (*check_lens_settings(paths), *profile_notes(paths)):
        say_note(note)
    (target,) = build_detectors(wanted.choices, camera_model)
    seen = [look_at_distance(str(path), open_picture(path), depth_m, target, camera_model) for path, depth_m in taken]
    known = [replace(each, is_confirmed=takes_perhaps) for each in seen]
    usable = tuple(each for each in known if each.is_usable)
    for each in known:
        if each.detection.is_whole and not each.is_usable:
            x_px, y_px = each.detection.centre_px
            perhaps = f"at {x_px:.0f}, {y_px:.0f} px is perhaps the target: {each.detection.reason}"
            typer.echo(f"left out: {each.picture}: {perhaps}; --perhaps takes it", err=True)
        elif not each.is_usable:
            remedy = remedy_words(each, open_picture(Path(each.picture)), wanted.choices[0], camera_model)
            typer.echo(f"left out: {each.picture}: {each.detection.reason}{remedy}", err=True)
        elif each.detection.reason:
            say_note(f"{each.picture}: {each.detection.reason}")
    return KnownPictures(usable=usable, all_usable=len(usable) == len(known))


def refuse_twice(paths: Sequence[Path]) -> None:
    """Raise a `ConfigError` if a picture is given twice."""
    for number, path in enumerate(paths):
        if path in paths[:number]:
            raise ConfigError(f"{path} is given twice; a picture says the same each time, so give each of them once")


def _split(text: str) -> tuple[Path, float]:
    path, at, length = text.rpartition("@")
    if not (at and path):
        raise ConfigError(f"{text!r} does not say how far away the target is; write it such as 2ft.png@24in")
    return Path(path), parse_known_length(length, path)


AtOption = Annotated[
    list[str] | None,
    typer.Option(
        "--at",
        metavar="DISTANCE",
        help="With --live: where to put the target, such as --at 1m --at 3m; else 1 m, then up to thrice that.",
    ),
]


def calibrate_live(
    live: str, at: Sequence[str], wanted: WantedTargets, *, distance_relative_sigma: float, tone_curve: ToneCurve
) -> Calibration:
    """Ask for the target at each distance, and return the calibration from all of them.

    Raises:
        CalibrationError: The distances contradict each other.
        StadimeterError: An option is wrong, or the camera gives no pictures.
    """
    _check(at)
    typer.echo("opening the camera …", err=True)
    try:
        with open_camera(camera_choice(live)) as source:
            for words in source.capture.remarks():
                say_note(words)
            session = LiveDistance(
                source,
                wanted.choices[0],
                date=today(),
                distance_relative_sigma=distance_relative_sigma,
                tone_curve=tone_curve,
            )
            typer.echo(f"Measure with a tape, from the lens to {session.measured_to}.")
            typer.echo("Keep it in the middle of the picture, and the camera still.")
            for number in range(max(2, len(at))):
                asked = at[number] if at else _advise_distance(session, wanted.unit)
                _say(_take(session, asked), wanted.unit)
            if session.to_centre_m:
                more = format_distance(session.to_centre_m, None, wanted.unit)
                typer.echo(f"The distances below are to the centre, which is {more} farther.")
            return _prove(session)
    except CalibrationError as error:
        raise CalibrationError(f"{error}\nnothing was written") from error
    except KeyboardInterrupt:
        _stop("stopped")


def _check(at: Sequence[str]) -> None:
    if len(at) == 1:
        raise ConfigError("one distance is not proved by another; give two, such as --at 1m --at 3m")
    for text in at:
        parse_known_length(text, "--at")


def _advise_distance(session: LiveDistance, unit: LengthUnit) -> str:
    """Return a first distance that suits most rooms, or the one that proves it best."""
    shown, first = (FOOT, 3.0) if unit in {FOOT, INCH} else (METRE, 1.0)
    following_m = session.next_distance_m
    return f"{first if following_m is None else following_m / shown.size_m:.3g} {shown.symbol}"


def _take(session: LiveDistance, asked: str) -> Take:
    """Ask for the target at a distance until it is found there."""
    while True:
        typer.echo(f"{'Now put' if session.takes else 'Put'} it at {asked}.")
        try:
            answer = input("Press Enter when it is there, or type the distance that it has: ").strip()
        except EOFError:
            _stop("there is no answer")
        try:
            distance_m = parse_known_length(answer or asked, "the distance")
            asked = answer or asked
            return session.take(distance_m, name=f"at {asked}")
        except (ConfigError, CalibrationError) as error:
            typer.echo(f"error: {error}", err=True)


def _prove(session: LiveDistance) -> Calibration:
    if not session.is_proved:
        raise CalibrationError(f"one distance does not prove the other: take one {APART_MIN:g} times as far at least")
    typer.echo("calculating …", err=True)
    return session.calibration()


def _stop(why: str) -> NoReturn:
    typer.echo(f"\nerror: {why}, so nothing was written", err=True)
    raise typer.Exit(NOT_FOUND)


def _say(take: Take, unit: LengthUnit) -> None:
    reads = ""
    if take.reads_m is not None:
        share = take.reads_m / take.distance_m - 1
        reads = f"\n    from what came before: {format_distance(take.reads_m, None, unit)} ({share:+.1%})"
    seen = f"{take.size_px:.1f} px, spread {take.spread_share:.2%}, found in {take.found} of {take.frames} frames"
    typer.echo(f"{take.name}: {seen}{reads}")
    if take.reason:
        say_note(take.reason)
