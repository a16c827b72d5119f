"""The group of commands ``calibrate``: a camera file from boards or known distances, how wrong one is, and sizes."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from msgspec.structs import asdict, replace

from stadimeter.app.detectors import build_detectors
from stadimeter.cli.exits import DONE, NOT_FOUND, count_items, plain_errors, say_note, working
from stadimeter.cli.formatting import CENTIMETRE, FOOT, INCH, LengthUnit, format_distance
from stadimeter.cli.target_options import (
    GivenTarget,
    LiveOption,
    Option,
    WantedTargets,
    ask_until,
    check_one_source,
    give_up,
    live_camera,
    parse_known_length,
    print_answer,
    split_pictures,
    takes_options,
    targets_from_options,
    tell_written,
)
from stadimeter.config.camera_file import load_camera_model, save_camera_model, save_stereo_rig
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import UNKNOWN_SIZE
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import CalibrationError, ConfigError, Problem
from stadimeter.ranging.board_calibration import VIEWS_ENOUGH, BoardCalibration
from stadimeter.ranging.calibration import (
    Calibration,
    CalibrationCheck,
    FocalLength,
    KnownDistance,
    check_calibration,
    off_axis_rad,
)
from stadimeter.ranging.flat import SheetShape, TagShape
from stadimeter.ranging.floor import CameraAboveFloor, camera_above, mean_of
from stadimeter.ranging.size_from_motion import LearntSize, StepErrors, StepView, learn_size
from stadimeter.ranging.stereo import straight_ahead_share
from stadimeter.ranging.stereo_calibration import StereoCalibration
from stadimeter.workbench.calibration import board_session, live_distance
from stadimeter.workbench.frame_source import Source
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.picture_metadata import check_lens_settings, other_lens_notes, with_lens_settings
from stadimeter.workbench.stereo import find_board_pairs, pair_pictures

# The command ``calibrate size``: how large a thing is, from how it grows while the camera moves by known steps --------

# What is assumed of a size that is not known: any other gives the same answer.
ASSUMED = "10cm"

_ONE_SIZE = {"--ball", "--tag", "--disc"}


@takes_options(
    step_error=Option(
        "PERCENT",
        "How far all moves may be wrong together, one standard deviation: 2 for the wheels of a robot.",
        limits=(0.0, 50.0),
    ),
    turn_error=Option(
        "DEGREES",
        "How far the camera may have turned between pictures: 2 in the hand, 0.1 on a slider.",
        limits=(0.0, 30.0),
    ),
)
def size(
    *,
    target: GivenTarget,
    pictures: Annotated[
        list[str],
        typer.Argument(
            metavar="PATH[@MOVE]",
            help="Pictures, and how far the camera has moved since the first one: start.jpg near.jpg@20cm.",
        ),
    ],
    camera: Path,
    step_error: float = 2.0,
    turn_error: float = 2.0,
    as_json: bool = False,
) -> None:
    """Find out how large a thing is, from how it grows in the picture as the camera comes nearer.

    Write `unknown` where its size belongs, or for a sheet two sides in the right proportion, such as 3cm,2cm. Take a
    picture, move the camera straight towards the thing by a known way, take another one, and so on; three or more
    pictures also show whether the thing stood still. Neither the thing nor the direction in which the camera looks may
    change. MOVE is how far the camera has moved since the first picture, not since the one before: `20cm` is 20 cm
    nearer, `20cm:right` to the right, `10cm:back` farther away; `20cm,5cm:up` is both. Half a metre, or a quarter of
    the distance, gives a size that is right within some per cent.

    Prints the size with its standard deviation, and the lines for the target's table in a configuration.
    With --json, the last line is one object: each side in metres, such as diameter_m, tolerance_m, and the shares.

    **Examples**

    - `stadimeter calibrate size a.jpg b.jpg@20cm c.jpg@40cm --camera camera.toml --ball unknown`

    - `stadimeter calibrate size a.jpg b.jpg@1ft c.jpg@2ft --camera camera.toml --sheet 3in,2in`

    **Exit code**: 0 the size was learnt from all pictures; 1 the thing was not found in some, which were left out, or
    nothing was learnt; 2 an option, a file or a picture is wrong, the moves do not tell the size, or the thing moved.
    """
    with plain_errors():
        wanted = targets_from_options(_with_assumed_size(target))
        errors = StepErrors(scale_share=step_error / 100, turn_rad=math.radians(turn_error))
        camera_model = load_camera_model(camera)
        session = live_distance.SizeSession(wanted.choices[0], camera_model)
        views, all_found = _step_views(pictures, session)
        learnt = learn_size(views, camera_model, errors)
        written = " ".join(text.rpartition("@")[2] for text in pictures[1:])
        unit = INCH if re.search(r"\d\s*(in|ft|\"|')", written) else CENTIMETRE
        figures = {f"{key}_m": each_m for key, each_m in session.sizes_m(learnt).items()} | asdict(learnt)
        del figures["factor"]
        print_answer(_size_lines(learnt, session, target, unit), figures, as_json=as_json)
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


def _step_views(pictures: Sequence[str], session: live_distance.SizeSession) -> tuple[list[StepView], bool]:
    """Return the views of the target in picture files, and whether it was found in all of them."""
    moved = "how far the camera has moved since the first picture"
    taken = split_pictures(pictures, live_distance.parse_move, moved, "20cm", (0.0, 0.0, 0.0))
    views = []
    for path, moved_m in taken:
        found, view = session.look(str(path), open_picture(path), moved_m)
        if view is None:
            typer.echo(f"left out: {path}: {found.reason}", err=True)
        else:
            views.append(view)
    if len(views) < 2 <= len(taken):
        give_up(
            f"the thing was found in {len(views)} of {len(taken)} pictures, and two are needed; `stadimeter measure "
            "--explain` with the same target says why not in the others; so nothing was learnt"
        )
    return views, len(views) == len(taken)


def _size_lines(
    learnt: LearntSize, session: live_distance.SizeSession, given: GivenTarget, unit: LengthUnit
) -> Iterator[str]:
    sizes_m = session.sizes_m(learnt)
    tolerance_m = sizes_m.pop("tolerance")
    for key, size_m in sizes_m.items():
        yield (
            f"{key} {format_distance(size_m, learnt.sigma_share * size_m, unit)} ({learnt.sigma_share:.1%}): "
            f"steps {learnt.steps_share:.1%}, turns {learnt.turn_share:.1%}, edges {learnt.edges_share:.1%}, "
            f"lens {learnt.lens_share:.1%}"
        )
    in_mm = {key: f"{1000 * length_m:.4g} mm" for key, length_m in {**sizes_m, "tolerance": tolerance_m}.items()}
    in_mm["tolerance"] = f"{1000 * tolerance_m:.2g} mm"
    yield "for the target's table in a configuration:"
    yield from (f'    {key} = "{text}"' for key, text in in_mm.items())
    flag = next((each for each in (*sorted(_ONE_SIZE), "--sheet") if given.get(each) is not None), None)
    if flag is not None:
        both = ",".join(text.replace(" ", "") for key, text in in_mm.items() if key != "tolerance")
        yield f"for other commands: {flag} {both} --tolerance {in_mm['tolerance'].replace(' ', '')}"
    if not learnt.is_proved:
        say_note("two places cannot show whether the thing came nearer or the move was wrong; a third one can")


# The command ``calibrate floor``: how high the camera is above the floor and how far it is tilted ---------------------

# A camera that is rolled by more is noted: what is 20 degrees aside then seems off in tilt by a third of that.
MUCH_ROLL_RAD = math.radians(0.5)


@takes_options()
def floor(
    *,
    target: GivenTarget,
    pictures: Annotated[list[Path], typer.Argument(metavar="IMAGE", help="Pictures of a tag or sheet on the floor.")],
    camera: Path,
    as_json: bool = False,
) -> None:
    """Find out how high the camera is above the floor and how far it is tilted.

    Lay a tag or a sheet of known size flat on the floor before the camera, as near as it is seen whole, and take a
    picture. Prints the lines for `[camera]` in a configuration, with which targets that have `on_floor` are measured by
    the floor as well. Several pictures, with the tag in other places, show how level the floor is.
    With --json, one object with height_m, height_sigma_m, tilt_rad, tilt_sigma_rad, roll_rad, and pictures likewise.

    **Examples**

    - `stadimeter calibrate floor tag.jpg --camera camera.toml --tag 8cm --family 36h11`

    **Exit code**: 0 the lines were printed, from all pictures; 1 it was not found in some, or is too small there to
    know how it lies; 2 an option, a file or a picture is wrong.
    """
    with plain_errors():
        wanted = targets_from_options(target)
        model = load_camera_model(camera)
        (named,) = build_detectors(wanted.choices, model)
        detector = named.detector
        shape = detector.target_shape
        if not isinstance(shape, SheetShape | TagShape):
            raise ConfigError(f"a {shape.label} does not show how the floor lies; lay a tag or a sheet on it")
        looked = [(str(path), _look(path, detector, shape, model)) for path in pictures]
        views = {path: view for path, view in looked if view is not None}
        if not views:
            give_up("no picture can be used")
        floor_view = mean_of([*views.values()])
        figures = {**asdict(floor_view), "pictures": [{"file": path, **asdict(each)} for path, each in views.items()]}
        print_answer(_floor_lines(views, floor_view), figures, as_json=as_json)
    raise typer.Exit(DONE if len(views) == len(pictures) else NOT_FOUND)


def _look(path: Path, detector: Detector, shape: SheetShape | TagShape, model: CameraModel) -> CameraAboveFloor | None:
    """Return the result of one picture, or say on standard error why it cannot be used."""
    frame = open_picture(path)
    lens = model.for_frame(frame)
    found = detector.detect(frame, lens=lens)
    reason = found.reason
    if found.status is DetectionStatus.FOUND:
        try:
            return camera_above(found, shape, lens)
        except CalibrationError as error:
            reason = str(error)
    typer.echo(f"left out: {path}: {reason}", err=True)
    return None


def _words(view: CameraAboveFloor) -> str:
    height = f"{100 * view.height_m:.1f} cm ± {100 * view.height_sigma_m:.1f}"
    tilt = f"{math.degrees(view.tilt_rad):.2f}° ± {math.degrees(view.tilt_sigma_rad):.2f}"
    return f"{height} above the floor, tilt {tilt}"


def _floor_lines(views: Mapping[str, CameraAboveFloor], view: CameraAboveFloor) -> Iterator[str]:
    yield from (f"{path}  {_words(each)}" for path, each in views.items())
    if abs(view.roll_rad) > MUCH_ROLL_RAD:
        side = "right" if view.roll_rad > 0 else "left"
        degrees = abs(math.degrees(view.roll_rad))
        say_note(f"the camera's {side} side is {degrees:.1f}° down; level it, since only its tilt is allowed for")
    height_mm, tilt_deg = 1000 * view.height_sigma_m, math.degrees(view.tilt_sigma_rad)
    yield "[camera]"
    yield f'height = "{100 * view.height_m:.2f} cm ± {max(height_mm, 0.1):.1f} mm"'
    yield f'tilt = "{math.degrees(view.tilt_rad):.2f} deg ± {max(tilt_deg, 0.01):.2f} deg"'


# The command ``calibrate stereo``: a stereo file from pictures of a board that two cameras took at the same time ------

# Distances at which it is said how sure a target's distance will be.
_SHOWN_M = (1.0, 3.0)


@takes_options(
    square_error=Option(
        "PERCENT",
        "How well you know the side of a square, one standard deviation in per cent; distances are as unsure.",
        limits=(0.0, 20.0),
    )
)
def stereo(
    *,
    pictures: Annotated[
        list[Path],
        typer.Argument(
            metavar="LEFT... RIGHT...",
            help="Pictures of the board: first those of the left camera, then as many of the right one, in one order.",
        ),
    ],
    output: Path,
    square: str,
    chessboard: str | None = None,
    charuco: str | None = None,
    marker: str | None = None,
    dictionary: str | None = None,
    square_error: float = 0.2,
    as_json: bool = False,
) -> None:
    """Calibrate two cameras that are fixed to each other, from pictures of a board that both took at the same time.

    Take 10 to 20 pairs as for `calibrate board`: the board whole in both pictures, tilted by 30 to 45 degrees to all
    sides, near and far, and in all parts of the pictures. Hold it still, or trigger both cameras together: what moved
    between the two pictures of a pair is named and left out.

    The left camera is the one from which distances are measured; seen from behind both it is the one on the left. The
    first half of the pictures is of the left one.

    The stereo file holds both lenses, where the right camera is, and how well all of that is known together. After that
    the cameras must not move against each other: a turn by a tenth of a degree is an error of several per cent.
    With --json, one object with file, replaced, baseline_m, baseline_sigma_m, rms_px, epipolar_px, and pairs.

    **Examples**

    - `stadimeter calibrate stereo left/*.jpg right/*.jpg --board 9x6 --square 25mm -o stereo.toml`

    - `stadimeter measure --stereo stereo.toml left.jpg right.jpg --ball 6.4cm`

    **Exit code**: 0 the stereo file was written from all pairs; 1 some pairs were left out, since the board was not in
    both pictures, they do not belong together, or show the same view; 2 an option, a file or a picture is wrong, or the
    pairs do not fix the cameras, and nothing was written.
    """
    with plain_errors():
        wanted = board_from_options(chessboard, charuco, square, marker, dictionary)
        pairs = pair_pictures(pictures)
        for side in zip(*pairs, strict=True):
            check_lens_settings(side)
        found = find_board_pairs(pairs, wanted, _watched)
        for left, right, reason in found.missed:
            typer.echo(f"left out: {left}, {right}: {reason}", err=True)
        with working("calibrating"):
            made = found.calibrate(square_error / 100)
        rig = made.rig
        baseline = {"baseline_m": rig.baseline_m, "baseline_sigma_m": rig.baseline_sigma_m}
        figures = {**baseline, "rms_px": made.rms_px, "epipolar_px": made.epipolar_px, "pairs": made.pairs}
        tell_written(output, partial(save_stereo_rig, rig=rig), _stereo_lines(made), figures, as_json=as_json)
    all_used = not found.missed and not any(each.why_left_out for each in made.pairs)
    raise typer.Exit(DONE if all_used else NOT_FOUND)


def _watched(paths: Sequence[Path]) -> Iterable[Path]:
    return count_items(paths, "looking for the board in pictures", len(paths))


def _stereo_lines(made: StereoCalibration) -> Iterator[str]:
    name_width = max(len(f"{each.left}, {each.right}") for each in made.pairs)
    for number, each in enumerate(made.pairs, 1):
        error = "" if math.isnan(each.rms_px) else f"error {each.rms_px:.2f} px, epipolar {each.epipolar_px:.2f} px"
        left_out = f"  left out: {each.why_left_out}" if each.why_left_out else ""
        yield f"pair {number:<2}  {f'{each.left}, {each.right}':<{name_width}}  {error}{left_out}".rstrip()
    rig, used = made.rig, sum(not each.why_left_out for each in made.pairs)
    yield f"error {made.rms_px:.3f} px over {used} pairs, epipolar {made.epipolar_px:.3f} px"
    for name, lens in (("left", rig.left), ("right", rig.right)):
        share = lens.focal_relative_sigma
        yield f"{name} camera: focal length {lens.fx_px:.1f} px ± {lens.fx_px * share:.1f} ({share:.2%})"
    turned = math.degrees(math.hypot(*rig.turn_rad))
    yield (
        f"the cameras are {1000 * rig.baseline_m:.2f} mm ± {1000 * rig.baseline_sigma_m:.2f} apart, and turned against "
        f"each other by {turned:.2f}°"
    )
    sure = ", ".join(f"{straight_ahead_share(rig, away_m):.2%} at {away_m:g} m" for away_m in _SHOWN_M)
    yield f"distances straight ahead are sure to {sure}, besides the noise of the pictures"
    if used < VIEWS_ENOUGH:
        say_note(f"{used} pairs are few, and may fit by chance; take 10 to 20")


_SIZE = re.compile(r"(\d{1,3})x(\d{1,3})")


@takes_options()
def board(
    *,
    pictures: Annotated[
        list[Path] | None, typer.Argument(metavar="PATH", help="Pictures of the board, 10 to 20.")
    ] = None,
    output: Path,
    square: str,
    chessboard: str | None = None,
    charuco: str | None = None,
    marker: str | None = None,
    dictionary: str | None = None,
    live: LiveOption = None,
    as_json: bool = False,
) -> None:
    """Calibrate a camera, distortion included, from pictures of a chessboard or a ChArUco board.

    Take 10 to 20 sharp pictures with the zoom and the focus that you will use. Tilt the board by 30 to 45 degrees to
    all sides: boards that face the camera do not tell the focal length. Bring it into every corner of the picture:
    where no board was, the distortion is a guess. Glue the board to something flat; a slight bend is found and allowed
    for.

    A low reprojection error alone says little. What counts is the standard deviation of the focal length, which is
    written to the camera file and into every distance.

    With --live no pictures need to be taken: move the board about before the camera, and hold it still for a moment
    each time. Each view is reported with its error, and with what is still missing. It ends when the views are enough,
    or with Ctrl-C, and calibrates from what it has.

    With --json, the last line is one object: file, replaced, camera_model with what the file holds, views, rms_px,
    coverage, uncovered and bend_m.

    **Examples**

    - `stadimeter calibrate board --live opencv,device=0 --board 9x6 --square 25mm -o camera.toml`

    - `stadimeter calibrate board *.jpg --board 9x6 --square 25mm -o camera.toml`

    - `stadimeter calibrate board *.jpg --charuco 5x7 --square 40mm --marker 20mm --dictionary 6X6_250 -o camera.toml`

    **Exit code**: 0 the camera file was written from all pictures, or from a camera; 1 some pictures were left out,
    since the board was not found, they fit far worse than the others or show the same view, or nothing was written,
    since it was found in none; 2 an option, a file or a picture is wrong, or the pictures do not fix the camera, and
    nothing was written.
    """
    with plain_errors():
        wanted = board_from_options(chessboard, charuco, square, marker, dictionary)
        check_one_source(pictures, live, "pictures of the board")
        made, all_used = _board_from_camera(live, wanted) if live else _board_from_pictures(pictures or [], wanted)
        write = partial(save_camera_model, model=made.camera_model)
        tell_written(output, write, _board_lines(made), asdict(made), as_json=as_json)
    raise typer.Exit(DONE if all_used else NOT_FOUND)


def _board_from_pictures(pictures: Sequence[Path], wanted: board_session.Board) -> tuple[BoardCalibration, bool]:
    """Return the calibration that pictures give, and whether all of them were used."""
    check_lens_settings(pictures)
    found = board_session.find_boards(pictures, wanted, _watched)
    for picture, reason in found.missed:
        typer.echo(f"left out: {picture}: {reason}", err=True)
    if not found.views:
        _never_found("the board was found in no picture")
    with working("calibrating"):
        made = found.calibrate(found.views)
    made = replace(made, camera_model=with_lens_settings(made.camera_model, pictures))
    return made, not found.missed and not any(view.was_left_out for view in made.views)


def _board_from_camera(live: str, wanted: board_session.Board) -> tuple[BoardCalibration, bool]:
    """Return the calibration that the views of a camera give; views that fit badly are part of the game."""
    session = views_from_camera(live, wanted)
    if not session.views:
        _never_found("the camera saw no view of the board")
    with working("calibrating"):
        made = session.calibration or session.calibrate(session.views)
    return made, True


def _never_found(what: str) -> NoReturn:
    give_up(
        f"{what}, so nothing was written; count its inner corners again, and see that all of it, with a white rim, is "
        "in the picture, sharp and evenly lit"
    )


def board_from_options(
    chessboard: str | None, charuco: str | None, square: str, marker: str | None, dictionary: str | None
) -> board_session.Board:
    """Return the board that the options describe; `ConfigError` if they contradict each other."""
    square_m = parse_known_length(square, "--square")
    if (chessboard is None) == (charuco is None):
        raise ConfigError("say which board it is: --board 9x6 for a chessboard, or --charuco 5x7, one of the two")
    if chessboard is not None:
        if marker is not None or dictionary is not None:
            raise ConfigError("--marker and --dictionary describe a ChArUco board; give --charuco instead of --board")
        columns, rows = _size(chessboard, "--board")
        return board_session.Chessboard(columns=columns, rows=rows, square_m=square_m)
    if marker is None or dictionary is None:
        raise ConfigError(
            "--charuco needs --marker LENGTH and --dictionary NAME, such as --marker 20mm --dictionary 4X4_50"
        )
    columns, rows = _size(charuco or "", "--charuco")
    marker_m = parse_known_length(marker, "--marker")
    return board_session.CharucoBoard(
        columns=columns, rows=rows, square_m=square_m, marker_m=marker_m, dictionary=dictionary
    )


def _size(text: str, option: str) -> tuple[int, int]:
    match = _SIZE.fullmatch(text.strip().lower().replace("×", "x"))
    if not match or min(int(match[1]), int(match[2])) < 3:
        raise ConfigError(f"{option} {text!r} is no size of a board; write columns and rows, such as 9x6, 3 at least")
    return int(match[1]), int(match[2])


def _board_lines(made: BoardCalibration) -> Iterator[str]:
    name_width = max(len(each.picture) for each in made.views)
    for each in made.views:
        error = "" if math.isnan(each.rms_px) else f", error {each.rms_px:.2f} px"
        left_out = f"  left out: {each.why_left_out}" if each.was_left_out else ""
        yield f"{each.picture:<{name_width}}  {each.corners} corners{error}{left_out}"
    model = made.camera_model
    used = sum(not each.was_left_out for each in made.views)
    yield f"error {made.rms_px:.3f} px over {used} pictures, with corners in {made.coverage:.0%} of the picture"
    share = model.focal_relative_sigma
    focal = f"{model.fx_px:.1f} px ± {model.fx_px * share:.1f} ({share:.2%}) across, {model.fy_px:.1f} px down"
    yield f"focal length {focal}, for pictures of {model.width_px}x{model.height_px}"
    for advice in _board_advice(made):
        say_note(advice)


def _board_advice(made: BoardCalibration) -> Iterator[str]:
    if made.bend_m > BEND_ADVICE_M:
        yield (
            f"the board is bent by {made.bend_m * 1e3:.1f} mm, which was allowed for; the focal length is surer with a "
            "board on glass or metal"
        )
    if made.camera_model.focal_relative_sigma > board_session.GOOD_FOCAL_SHARE:
        yield "the focal length is not well known; add pictures with the board tilted by 30 to 45 degrees"
    if made.uncovered:
        yield f"no corner was seen in the {', '.join(made.uncovered)} of the picture; bring the board there"
    elif made.coverage < board_session.GOOD_COVERAGE:
        yield "the board was seen in little of the picture; bring it nearer, and into every corner"


# A board that is bent by less is as flat as one can have it at home.
BEND_ADVICE_M = 0.0005

# Why no view is taken is said this often at most, in time of capture.
SAY_EVERY_S = 2.0


def views_from_camera(live: str, board: board_session.Board) -> board_session.BoardSession:
    """Return the views that were taken until they are enough, the camera's frames end, or Ctrl-C is pressed."""
    with live_camera(live) as source:
        session = board_session.BoardSession(board, must_be_steady=source.is_live)
        if source.is_live:
            typer.echo("move the board about, tilt it, and hold it still for a moment each time; Ctrl-C ends it")
        try:
            _collect(source, session)
        except KeyboardInterrupt:
            typer.echo(f"stopped with {len(session.views)} views", err=True)
    return session


def _collect(source: Source, session: board_session.BoardSession) -> None:
    """Report each view that is taken at once, and now and then why none is; of a recording, every frame."""
    said, said_at_s = "", -math.inf
    for frame in source.frames(say_note):
        why_not = session.look(frame)
        if not why_not:
            said = ""
            _tell_view(session)
        elif not source.is_live:
            typer.echo(f"left out: {frame.source or f'frame {frame.sequence}'}: {why_not}", err=True)
        elif why_not != said and frame.captured_at_s >= said_at_s + SAY_EVERY_S:
            said, said_at_s = why_not, frame.captured_at_s
            typer.echo(f"          {why_not}")
        if session.is_done:
            return


def _tell_view(session: board_session.BoardSession) -> None:
    made, newest = session.calibration, session.views[-1]
    figures = f"{len(newest.corners_px)} corners"
    if made is not None:
        each = made.views[-1]
        error = f", left out: {each.why_left_out}" if each.was_left_out else f", error {each.rms_px:.2f} px"
        model = made.camera_model
        focal = f"focal length {model.fx_px:.0f} px ± {model.focal_relative_sigma:.1%}"
        figures += f"{error}; {focal}, corners in {made.coverage:.0%} of the picture"
    bell = "\a" if sys.stdout.isatty() else ""  # the person with the board may be too far away to read
    typer.echo(f"{bell}{newest.picture}  {figures}")
    missing = session.missing()
    typer.echo(f"          still missing: {'; '.join(missing)}" if missing else "          that is enough")


# The group, with ``calibrate distance`` and ``calibrate check`` -------------------------------------------------------

calibrate = typer.Typer(no_args_is_help=True)


@calibrate.callback()
def _calibrate() -> None:
    """Find a camera's focal length, or how large a target is."""


_PATH_AT_DISTANCE = typer.Argument(
    metavar="PATH@DISTANCE", help="Pictures of the target at known distances: 2ft.png@24in."
)
PicturesAtDistances = Annotated[list[str], _PATH_AT_DISTANCE]
MaybePicturesAtDistances = Annotated[list[str] | None, _PATH_AT_DISTANCE]


@calibrate.command("distance")
@takes_options(
    at=Option("DISTANCE", "With --live: where to put the target, such as --at 1m --at 3m; else 1 m, then 3 m.")
)
def distance(
    *,
    target: GivenTarget,
    pictures: MaybePicturesAtDistances = None,
    live: LiveOption = None,
    at: list[str] | None = None,
    output: Path,
    distance_error: float = 1.0,
    as_json: bool = False,
) -> None:
    """Calibrate a camera from pictures of a target at known distances.

    Take a picture of a sheet of paper or a ball of known size in the middle of the picture, the sheet facing the
    camera, and measure with a tape how far it is from the lens. DISTANCE is the depth, along the direction in which the
    camera looks; in the middle of the picture that is the straight line. One picture is enough; several, at different
    distances, are better: how far they differ shows how sure the focal length is, and from near and far ones the edge
    bias is found as well, by how much every edge is seen too far out.

    What is only perhaps the target calibrates nothing: come nearer, or add light.

    With --live the program takes the pictures itself: it asks for the target at one distance, takes several frames,
    then asks for it at another one, which proves the first. Here a distance is measured from the lens to the target's
    nearest point; those that are printed at the end are to its middle. If the distances contradict each other by more
    than --distance-error allows, nothing is written.

    With --json, the last line is one object: file, replaced, camera_model with what the file holds, pictures with the
    focal length that each gives, and fit with the focal length and the edge bias of all.

    Then `stadimeter measure` and `stadimeter run` need the camera file, and pictures from the same camera at any
    resolution of the same aspect, with the same zoom. An existing file is replaced.

    **Examples**

    - `stadimeter calibrate distance 2ft.png@24in --sheet 11in,8.5in -o camera.toml`

    - `stadimeter calibrate distance a.jpg@50cm b.jpg@1m --ball 6.4cm --hsv "29,86,6:64,255,255" -o camera.toml`

    - `stadimeter calibrate distance --live opencv,device=0 --ball 6.4cm --hsv "29,86,6:64,255,255" -o camera.toml`

    **Exit code**: 0 the camera file was written from all pictures; 1 some were left out, since the target was not
    found in them, or all, and then nothing was written; 2 an option, a file or a picture is wrong, or distances
    contradict each other, and nothing was written.
    """
    with plain_errors():
        check_one_source(pictures, live, "pictures at known distances")
        if at and not live:
            raise ConfigError("--at says where to put the target before a camera; give --live with it")
        wanted = targets_from_options(target)
        if live:
            if not output.parent.is_dir():  # known before the person walks to and fro, not after it
                raise ConfigError([Problem(f"there is no folder {output.parent} for {output.name}", key="-o")])
            made = _live_distances(live, at or [], wanted, distance_error / 100)
            all_found = True
        else:
            made, all_found = _from_pictures(pictures or [], wanted, distance_error / 100)
        write = partial(save_camera_model, model=made.camera_model)
        tell_written(output, write, _lines(made, wanted.unit), asdict(made), as_json=as_json)
    raise typer.Exit(DONE if all_found else NOT_FOUND)


def _from_pictures(
    pictures: Sequence[str], wanted: WantedTargets, distance_relative_sigma: float
) -> tuple[Calibration, bool]:
    """Calibrate; return the calibration, and whether it comes from all pictures."""
    usable = _look_at(pictures, wanted, None)
    if not usable:
        _nothing_written("no picture can be used")
    made, all_found = _fit(usable, lambda name: open_picture(Path(name)), wanted, distance_relative_sigma)
    model = with_lens_settings(made.camera_model, [Path(each.picture) for each in usable])
    made = replace(made, camera_model=model)
    return made, all_found and len(usable) == len(pictures)


def _fit(
    usable: Sequence[KnownDistance], frame_of: live_distance.FrameOf, wanted: WantedTargets, distance_sigma: float
) -> tuple[Calibration, bool]:
    """Calibrate; return the calibration, and whether it comes from all pictures. Say which were left out, and why."""
    fit = live_distance.fit_distances(usable, frame_of, wanted.choices, distance_relative_sigma=distance_sigma)
    for each in fit.left_out:
        remedy = live_distance.remedy_words(each, frame_of(each.picture), wanted.choices[0])
        reason = f"through the camera file it is not found: {each.detection.reason}{remedy}"
        typer.echo(f"left out: {each.picture}: {reason}", err=True)
    for each in fit.elsewhere:
        there = f"{each.detection.centre_px[0]:.0f}, {each.detection.centre_px[1]:.0f} px"
        say_note(f"{each.picture}: the target is taken to be at {there}; check it with `stadimeter measure --annotate`")
    if fit.calibration is None:
        _nothing_written("no picture can be used")
    return fit.calibration, not fit.left_out


def _look_at(pictures: Sequence[str], wanted: WantedTargets, camera_model: CameraModel | None) -> list[KnownDistance]:
    """Return the pictures in which the target is found; say on standard error which cannot be used, and why."""
    taken = split_pictures(pictures, parse_known_length, "how far away the target is", "24in")
    for note in other_lens_notes(camera_model, [path for path, _ in taken]) if camera_model else ():
        say_note(note)
    (target,) = build_detectors(wanted.choices, camera_model)
    known = [
        live_distance.look_at_distance(str(path), open_picture(path), depth_m, target, camera_model)
        for path, depth_m in taken
    ]
    for each in known:
        if each.detection.is_whole and not each.is_usable:
            x_px, y_px = each.detection.centre_px
            perhaps = f"at {x_px:.0f}, {y_px:.0f} px is perhaps the target: {each.detection.reason}"
            typer.echo(f"left out: {each.picture}: {perhaps}", err=True)
        elif not each.is_usable:
            remedy = live_distance.remedy_words(each, open_picture(Path(each.picture)), wanted.choices[0], camera_model)
            typer.echo(f"left out: {each.picture}: {each.detection.reason}{remedy}", err=True)
        elif each.detection.reason:
            say_note(f"{each.picture}: {each.detection.reason}")
    return [each for each in known if each.is_usable]


def _live_distances(live: str, at: Sequence[str], wanted: WantedTargets, distance_relative_sigma: float) -> Calibration:
    """Ask for the target at each distance, and return the calibration from all of them.

    Raises:
        CalibrationError: The distances contradict each other.
    """
    if len(at) == 1:
        raise ConfigError("one distance is not proved by another; give two, such as --at 1m --at 3m")
    for text in at:
        parse_known_length(text, "--at")
    (named,) = build_detectors(wanted.choices, None)
    takes: dict[str, live_distance.Take] = {}
    with live_camera(live) as source:
        point = "nearest point of the " if named.detector.target_shape.limb_radius_m else ""
        typer.echo(f"Measure with a tape, from the lens to the {point}{named.name}.")
        typer.echo("Keep it in the middle of the picture, and the camera still.")
        for asked in at or (("3 ft", "9 ft") if wanted.unit in {FOOT, INCH} else ("1 m", "3 m")):
            ask = partial(_ask_for, f"{'Now put' if takes else 'Put'} it at {asked}.")
            taken = ask_until(ask, _nothing_written, partial(_take, source, wanted.choices[0], asked))
            takes[taken.known.picture] = taken
    known = [each.known for each in takes.values()]
    made, all_found = _fit(known, lambda name: takes[name].frame, wanted, distance_relative_sigma)
    if not all_found:
        _nothing_written("a distance cannot be used")
    return made


def _nothing_written(why: str) -> NoReturn:
    give_up(f"{why}, so nothing was written")


def _ask_for(words: str) -> str:
    typer.echo(words)
    return "Press Enter when it is there, or type the distance that it has: "


def _take(source: Source, choice: DriverChoice, asked: str, answer: str) -> live_distance.Take:
    """Take the target at a distance, and say how it was found."""
    distance_m = parse_known_length(answer or asked, "the distance")
    taken = live_distance.take_at(source, choice, distance_m, name=f"at {answer or asked}")
    typer.echo(f"{taken.known.picture}: {taken.words}")
    if taken.known.detection.reason:
        say_note(taken.known.detection.reason)
    return taken


def _lines(made: Calibration, unit: LengthUnit) -> Iterator[str]:
    name_width = max(len(each.picture) for each in made.pictures)
    for each in made.pictures:
        yield _picture_line(each, name_width, unit)
    model = made.camera_model
    share = model.focal_relative_sigma
    yield (
        f"focal length {model.fx_px:.1f} px ± {model.fx_px * share:.1f} ({share:.1%}) "
        f"for pictures of {model.width_px}x{model.height_px}"
    )
    if made.fit.bias_was_fitted:
        yield f"edge bias {made.fit.edge_bias_px:+.2f} px ± {made.fit.edge_bias_sigma_px:.2f}"
    elif len(made.pictures) > 1:
        yield f"edge bias taken as 0: {_why_no_bias(made)}"


def _picture_line(each: FocalLength, name_width: int, unit: LengthUnit) -> str:
    away = format_distance(each.depth_m, None, unit)
    if words := live_distance.off_axis_words(each.picture, each.off_axis_rad, away):
        say_note(words)
    return (
        f"{each.picture:<{name_width}}  {each.width_px:.1f} x {each.height_px:.1f} px at {away}:  "
        f"focal length {each.focal_px:.1f} px ± {each.focal_px * each.relative_sigma:.1f}; the camera file "
        f"{each.reads}"
    )


def _why_no_bias(made: Calibration) -> str:
    if made.one_distance:
        return "all pictures are at one distance, where it looks like another focal length; add one from far away"
    if math.isinf(made.fit.edge_bias_sigma_px):
        return "what this detector sees does not tell it"
    return (
        f"these distances tell it only within ± {made.fit.edge_bias_sigma_px:.1f} px; add one from farther away, or "
        "measure the distances better and say so with --distance-error"
    )


calibrate.command("board")(board)
calibrate.command("stereo")(stereo)
calibrate.command("floor")(floor)
calibrate.command("size")(size)


@calibrate.command("check")
@takes_options()
def check(
    *,
    target: GivenTarget,
    pictures: PicturesAtDistances,
    camera: Path,
    distance_error: float = 1.0,
    as_json: bool = False,
) -> None:
    """Show how wrong a camera file is, from new pictures of a target at known distances.

    Take the pictures as for `calibrate distance`, but not the same ones. Each error is given in per cent, and in
    standard deviations of what the camera file, the picture and the tape together allow.
    With --json, one object with is_sound, bias_share, bias_sigma_share, and the errors of the pictures.

    **Example**

    - `stadimeter calibrate check 3ft.png@36in 4ft.png@48in --camera camera.toml --sheet 11in,8.5in`

    **Exit code**: 0 all errors are within what is stated; 1 they are not, or the target was not found in a picture; 2
    an option, a file or a picture is wrong.
    """
    with plain_errors():
        wanted = targets_from_options(target)
        model = load_camera_model(camera)
        usable = _look_at(pictures, wanted, model)
        if not usable:
            give_up("no picture can be used, so nothing was checked")
        for each in usable:
            away = format_distance(each.depth_m, None, wanted.unit)
            if words := live_distance.off_axis_words(each.picture, off_axis_rad(each, model), away):
                say_note(words)
        checked = check_calibration(usable, model, distance_relative_sigma=distance_error / 100)
        figures = {"is_sound": checked.is_sound, **asdict(checked)}
        print_answer(_check_lines(checked, camera, wanted.unit), figures, as_json=as_json)
    raise typer.Exit(DONE if checked.is_sound and len(usable) == len(pictures) else NOT_FOUND)


def _check_lines(checked: CalibrationCheck, camera: Path, unit: LengthUnit) -> Iterator[str]:
    name_width = max(len(each.picture) for each in checked.pictures)
    for each in checked.pictures:
        measured = format_distance(each.measured_m, None, unit)
        yield (
            f"{each.picture:<{name_width}}  {measured} instead of {format_distance(each.depth_m, None, unit)}:  "
            f"{each.error_share:+.2%}, {abs(each.sigmas):.1f} σ{'  outside' if each.is_outside else ''}"
        )
    yield f"mean error {checked.bias_share:+.2%} ± {checked.bias_sigma_share:.2%}"
    yield _verdict(checked, camera)


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
