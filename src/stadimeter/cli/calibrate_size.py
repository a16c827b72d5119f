"""The command ``calibrate size``: how large a thing is, from how it grows while the camera moves by known steps."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, read_option, say_note
from stadimeter.cli.formatting import CENTIMETRE, INCH, LengthUnit, format_distance
from stadimeter.cli.known_pictures import refuse_twice
from stadimeter.cli.target_options import (
    GivenTarget,
    LiveOption,
    camera_choice,
    targets_from_options,
)
from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.units import LENGTHS_M, UNKNOWN_SIZE, parse_quantity
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.size_from_motion import LearntSize, StepErrors, StepView, Vector, learn_size
from stadimeter.workbench.calibration.size_by_steps import SizeSession, parse_move
from stadimeter.workbench.frame_source import open_camera
from stadimeter.workbench.picture_metadata import check_lens_settings, profile_notes

# What is assumed of a size that is not known: any other gives the same answer.
ASSUMED = "10cm"

# Where the camera is moved to with --live if nothing else is said.
USUAL_MOVES = ("20cm", "40cm")

_ONE_SIZE = {"--ball", "--tag", "--disc"}

_Pictures = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="PATH[@MOVE]",
        help="Pictures, and how far the camera has moved since the first one: start.jpg near.jpg@20cm.",
    ),
]
_Moves = Annotated[
    list[str] | None,
    typer.Option(
        "--move",
        metavar="MOVE",
        help="With --live: where to move the camera, such as --move 30cm --move 60cm; else 20 cm, then 40 cm.",
    ),
]
_StepError = Annotated[
    float,
    typer.Option(
        "--step-error",
        metavar="PERCENT",
        min=0.0,
        max=50.0,
        help="How far all moves may be wrong together, one standard deviation: 2 for the wheels of a robot.",
    ),
]
_PlaceError = Annotated[
    str,
    typer.Option("--place-error", metavar="LENGTH", help="How far the camera may be beside each place."),
]
_TurnError = Annotated[
    float,
    typer.Option(
        "--turn-error",
        metavar="DEGREES",
        min=0.0,
        max=30.0,
        help="How far the camera may have turned between pictures: 2 in the hand, 0.1 on a slider.",
    ),
]


def size(
    *,
    target: GivenTarget,
    pictures: _Pictures = None,
    camera: Annotated[Path, typer.Option("--camera", metavar="FILE", help="The camera file.")],
    live: LiveOption = None,
    moves: _Moves = None,
    step_error: _StepError = 2.0,
    place_error: _PlaceError = "4mm",
    turn_error: _TurnError = 2.0,
) -> None:
    """Find out how large a thing is, from how it grows in the picture as the camera comes nearer.

    Write `unknown` where its size belongs, or for a sheet two sides in the right proportion, such as 3cm,2cm. Take a
    picture, move the camera straight towards the thing by a known way, take another one, and so on; three or more
    pictures also show whether the thing stood still. Neither the thing nor the direction in which the camera looks may
    change. MOVE is how far the camera has moved since the first picture, not since the one before: `20cm` is 20 cm
    nearer, `20cm:right` to the right, `10cm:back` farther away; `20cm,5cm:up` is both. Half a metre, or a quarter of
    the distance, gives a size that is right within some per cent.

    Prints the size with its standard deviation, and the lines for the target's table in a configuration.

    With --live the program takes the pictures itself, and says when to move the camera.

    **Examples**

    - `stadimeter calibrate size a.jpg b.jpg@20cm c.jpg@40cm --camera camera.toml --ball unknown`

    - `stadimeter calibrate size a.jpg b.jpg@1ft c.jpg@2ft --camera camera.toml --sheet 3in,2in`

    - `stadimeter calibrate size --live opencv,device=0 --camera camera.toml --tag unknown --family 36h11`

    **Exit code**: 0 the size was learnt from all pictures; 1 the thing was not found in some, which were left out, or
    nothing was learnt; 2 an option, a file or a picture is wrong, the moves do not tell the size, or the thing moved.
    """
    with plain_errors():
        if bool(pictures) == bool(live):
            raise ConfigError("give pictures with the camera's moves, or --live for a camera, one of the two")
        if moves and not live:
            raise ConfigError("--move says where to move the camera before pictures are taken; give --live with it")
        wanted = targets_from_options(_with_assumed_size(target))
        errors = StepErrors(
            scale_share=step_error / 100,
            place_m=read_option(_parse_not_negative, place_error, "--place-error"),
            turn_rad=math.radians(turn_error),
        )
        camera_model = load_camera_model(camera)
        session = SizeSession(wanted.choices[0], camera_model)
        views, all_found = (
            (_from_camera(live, moves or USUAL_MOVES, session), True) if live else _from_files(pictures or [], session)
        )
        learnt = learn_size(views, camera_model, errors)
        written = " ".join(text.rpartition("@")[2] for text in moves or (pictures or [])[1:])
        _tell(learnt, session, target, INCH if re.search(r"\d\s*(in|ft|\"|')", written) else CENTIMETRE)
    raise typer.Exit(DONE if all_found else NOT_FOUND)


def _with_assumed_size(given: GivenTarget) -> GivenTarget:
    if given.get("--tolerance") is not None:
        raise ConfigError("--tolerance says how well a size is known, and this command finds that out; leave it out")
    words = {flag: str(given[flag]).strip().lower() for flag in (*_ONE_SIZE, "--sheet") if given.get(flag) is not None}
    if words.get("--sheet") in UNKNOWN_SIZE:
        raise ConfigError(
            "--sheet: the proportion of its sides must be known; write it as two lengths, such as 3cm,2cm for 3 : 2"
        )
    return {**given, **{flag: ASSUMED for flag, word in words.items() if word in UNKNOWN_SIZE}}


def _from_files(pictures: Sequence[str], session: SizeSession) -> tuple[list[StepView], bool]:
    """Return the views of the target in picture files, and whether it was found in all of them."""
    taken = [_split(each, is_first=index == 0) for index, each in enumerate(pictures)]
    paths = [path for path, _ in taken]
    refuse_twice(paths)
    for note in (*check_lens_settings(paths), *profile_notes(paths)):
        say_note(note)
    views = []
    for path, moved_m in taken:
        looked = session.look_in_file(path, moved_m)
        if looked.view is None:
            typer.echo(f"left out: {path}: {looked.detection.reason}", err=True)
        else:
            views.append(looked.view)
    if len(views) < 2 <= len(taken):
        _nothing_learnt(
            f"the thing was found in {len(views)} of {len(taken)} pictures, and two are needed; "
            "`stadimeter measure --explain` with the same target says why not in the others"
        )
    return views, len(views) == len(taken)


def _split(text: str, *, is_first: bool) -> tuple[Path, Vector]:
    path, at, move = text.rpartition("@")
    if at and path:
        return Path(path), parse_move(move, path)
    if is_first:
        return Path(text), (0.0, 0.0, 0.0)
    raise ConfigError(
        f"{text!r} does not say how far the camera has moved since the first picture; write it such as {text}@20cm"
    )


def _parse_not_negative(text: str) -> float:
    value = parse_quantity(text, LENGTHS_M, "20 cm")
    if value < 0:
        raise ValueError(f"{text!r} is below zero")
    return value


def _from_camera(live: str, moves: Sequence[str], session: SizeSession) -> list[StepView]:
    """Ask for the camera at each place, and return how the target is seen from there."""
    for text in moves:
        parse_move(text, "--move")
    typer.echo("opening the camera …", err=True)
    try:
        with open_camera(camera_choice(live)) as source:
            for words in source.capture.remarks():
                say_note(words)
            typer.echo("Keep the thing where it is, in the middle of the picture, and the camera looking the same way.")
            views: list[StepView] = []
            for asked in ("0 cm", *moves):
                views.append(_take(asked, is_first=not views, take=lambda name, m: session.take(source, name, m)))
            return views
    except KeyboardInterrupt:
        _nothing_learnt("stopped")


def _take(asked: str, *, is_first: bool, take: Callable[[str, Vector], StepView]) -> StepView:
    """Ask for the camera at a place until the target is found from there."""
    begin = "Put the camera where it shall begin."
    while True:
        typer.echo(begin if is_first else f"Now move it to {asked} from where it began, straight towards the thing.")
        question = (
            "Press Enter when it is there: "
            if is_first
            else ("Press Enter when it is there, or type how far from the beginning it is: ")
        )
        try:
            answer = input(question).strip()
        except EOFError:
            _nothing_learnt("there is no answer")
        asked = asked if is_first else answer or asked
        try:
            view = take(f"at {asked}", parse_move(asked, "the move"))
        except (ConfigError, CalibrationError) as error:
            typer.echo(f"error: {error}", err=True)
            continue
        return view


def _nothing_learnt(why: str) -> NoReturn:
    typer.echo(f"error: {why}, so nothing was learnt", err=True)
    raise typer.Exit(NOT_FOUND)


def _tell(learnt: LearntSize, session: SizeSession, given: GivenTarget, unit: LengthUnit) -> None:
    sizes_m = session.sizes_m(learnt)
    tolerance_m = sizes_m.pop("tolerance")
    for key, size_m in sizes_m.items():
        typer.echo(
            f"{key} {format_distance(size_m, learnt.sigma_share * size_m, unit)} ({learnt.sigma_share:.1%}): "
            f"steps {learnt.steps_share:.1%}, turns {learnt.turn_share:.1%}, edges {learnt.edges_share:.1%}, "
            f"lens {learnt.lens_share:.1%}"
        )
    in_mm = {key: f"{1000 * length_m:.4g} mm" for key, length_m in {**sizes_m, "tolerance": tolerance_m}.items()}
    in_mm["tolerance"] = f"{1000 * tolerance_m:.2g} mm"
    typer.echo("for the target's table in a configuration:")
    for key, text in in_mm.items():
        typer.echo(f'    {key} = "{text}"')
    flag = next((each for each in (*sorted(_ONE_SIZE), "--sheet") if given.get(each) is not None), None)
    if flag is not None:
        both = ",".join(text.replace(" ", "") for key, text in in_mm.items() if key != "tolerance")
        typer.echo(f"for other commands: {flag} {both} --tolerance {in_mm['tolerance'].replace(' ', '')}")
    if not learnt.is_proved:
        say_note("two places cannot show whether the thing came nearer or the move was wrong; a third one can")
