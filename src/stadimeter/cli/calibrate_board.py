"""The command ``calibrate board``: a camera file, distortion included, from pictures of a chessboard."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from msgspec.structs import asdict

from stadimeter.cli.exits import DONE, NOT_FOUND, count_items, plain_errors, say_note, working
from stadimeter.cli.target_options import (
    LiveOption,
    Option,
    check_one_source,
    give_up,
    live_camera,
    parse_known_length,
    takes_options,
    tell_written,
)
from stadimeter.config.camera_file import save_camera_model, save_stereo_rig
from stadimeter.errors import ConfigError
from stadimeter.ranging.board_calibration import VIEWS_ENOUGH, BoardCalibration, calibrate_board
from stadimeter.ranging.stereo import straight_ahead_share
from stadimeter.ranging.stereo_calibration import StereoCalibration
from stadimeter.workbench.calibration.board_session import (
    GOOD_COVERAGE,
    GOOD_FOCAL_SHARE,
    Board,
    BoardSession,
    CharucoBoard,
    Chessboard,
    find_boards,
    today,
)
from stadimeter.workbench.frame_source import Source
from stadimeter.workbench.picture_metadata import check_lens_settings
from stadimeter.workbench.stereo import find_board_pairs, pair_pictures

# The command ``calibrate stereo``: a stereo file from pictures of a board that two cameras took at the same time ------

# Distances at which it is said how sure a target's distance will be.
_SHOWN_M = (1.0, 3.0)

# A farthest board that is less than this many times as far away as the nearest one hardly tells turn from place.
_ONE_DISTANCE = 1.3

# A distance at 3 m that is less sure than this share is nothing to rely on.
_UNSURE_SHARE = 0.02


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
    for advice in _advice_stereo(made, used):
        say_note(advice)


def _advice_stereo(made: StereoCalibration, used: int) -> list[str]:
    distances_m = [each.distance_m for each in made.pairs if not each.why_left_out]
    nearest_m, farthest_m = min(distances_m), max(distances_m)
    advice = []
    if used < VIEWS_ENOUGH:
        advice.append(f"{used} pairs are few, and may fit by chance; take 10 to 20")
    if farthest_m < _ONE_DISTANCE * nearest_m:
        advice.append(
            f"all boards were {nearest_m:.2f} to {farthest_m:.2f} m away; at one distance the turn of a camera looks "
            "much like its place, so add pairs with the board farther away and nearer"
        )
    if straight_ahead_share(made.rig, _SHOWN_M[1]) > _UNSURE_SHARE:
        advice.append(
            "far away the distance will be unsure: put the cameras farther apart, or add pairs with the board tilted, "
            "farther away, and in the corners of both pictures"
        )
    return advice


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
        made, all_used = _from_camera(live, wanted) if live else _from_pictures(pictures or [], wanted)
        write = partial(save_camera_model, model=made.camera_model)
        tell_written(output, write, _lines(made), asdict(made), as_json=as_json)
    raise typer.Exit(DONE if all_used else NOT_FOUND)


def _from_pictures(pictures: Sequence[Path], wanted: Board) -> tuple[BoardCalibration, bool]:
    """Return the calibration that pictures give, and whether all of them were used."""
    check_lens_settings(pictures)
    found = find_boards(pictures, wanted, _watched)
    for picture, reason in found.missed:
        typer.echo(f"left out: {picture}: {reason}", err=True)
    if not found.views:
        _never_found("the board was found in no picture")
    with working("calibrating"):
        made = calibrate_board(found.views, found.width_px, found.height_px, date=today(), optics=found.optics)
    return made, not found.missed and not any(view.was_left_out for view in made.views)


def _from_camera(live: str, wanted: Board) -> tuple[BoardCalibration, bool]:
    """Return the calibration that the views of a camera give; views that fit badly are part of the game."""
    session = views_from_camera(live, wanted)
    if not session.views:
        _never_found("the camera saw no view of the board")
    with working("calibrating"):
        made = session.calibration or calibrate_board(
            session.views, session.width_px, session.height_px, date=today(), optics=session.optics
        )
    return made, True


def _never_found(what: str) -> NoReturn:
    give_up(
        f"{what}, so nothing was written; count its inner corners again, and see that all of it, with a white rim, is "
        "in the picture, sharp and evenly lit"
    )


def board_from_options(
    chessboard: str | None, charuco: str | None, square: str, marker: str | None, dictionary: str | None
) -> Board:
    """Return the board that the options describe; `ConfigError` if they contradict each other."""
    square_m = parse_known_length(square, "--square")
    if (chessboard is None) == (charuco is None):
        raise ConfigError("say which board it is: --board 9x6 for a chessboard, or --charuco 5x7, one of the two")
    if chessboard is not None:
        if marker is not None or dictionary is not None:
            raise ConfigError("--marker and --dictionary describe a ChArUco board; give --charuco instead of --board")
        columns, rows = _size(chessboard, "--board", 3)
        return Chessboard(columns=columns, rows=rows, square_m=square_m)
    if marker is None or dictionary is None:
        raise ConfigError(
            "--charuco needs --marker LENGTH and --dictionary NAME, such as --marker 20mm --dictionary 4X4_50"
        )
    columns, rows = _size(charuco or "", "--charuco", 3)
    marker_m = parse_known_length(marker, "--marker")
    return CharucoBoard(columns=columns, rows=rows, square_m=square_m, marker_m=marker_m, dictionary=dictionary)


def _size(text: str, option: str, least: int) -> tuple[int, int]:
    match = _SIZE.fullmatch(text.strip().lower().replace("×", "x"))
    if not match or min(int(match[1]), int(match[2])) < least:
        raise ConfigError(
            f"{option} {text!r} is no size of a board; write columns and rows, such as 9x6, {least} at least"
        )
    return int(match[1]), int(match[2])


def _lines(made: BoardCalibration) -> Iterator[str]:
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
    for advice in _advice(made):
        say_note(advice)


def _advice(made: BoardCalibration) -> list[str]:
    advice = []
    if made.bend_m > BEND_ADVICE_M:
        advice.append(
            f"the board is bent by {made.bend_m * 1e3:.1f} mm, which was allowed for; the focal length is surer with a "
            "board on glass or metal"
        )
    if made.camera_model.focal_relative_sigma > GOOD_FOCAL_SHARE:
        advice.append("the focal length is not well known; add pictures with the board tilted by 30 to 45 degrees")
    if made.uncovered:
        advice.append(f"no corner was seen in the {', '.join(made.uncovered)} of the picture; bring the board there")
    elif made.coverage < GOOD_COVERAGE:
        advice.append("the board was seen in little of the picture; bring it nearer, and into every corner")
    return advice


# A board that is bent by less is as flat as one can have it at home.
BEND_ADVICE_M = 0.0005

# Why no view is taken is said this often at most, in time of capture.
SAY_EVERY_S = 2.0


def views_from_camera(live: str, board: Board) -> BoardSession:
    """Return the views that were taken until they are enough, the camera's frames end, or Ctrl-C is pressed."""
    with live_camera(live) as source:
        session = BoardSession(board, date=today(), must_be_steady=source.is_live)
        if source.is_live:
            typer.echo("move the board about, tilt it, and hold it still for a moment each time; Ctrl-C ends it")
        try:
            _collect(source, session)
        except KeyboardInterrupt:
            typer.echo(f"stopped with {len(session.views)} views", err=True)
    return session


def _collect(source: Source, session: BoardSession) -> None:
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


def _tell_view(session: BoardSession) -> None:
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
