"""The command ``calibrate stereo``: a stereo file from pictures of a board that two cameras took at the same time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from stadimeter.cli.calibrate_board import (
    CharucoOption,
    ChessboardOption,
    DictionaryOption,
    MarkerOption,
    board_from_options,
)
from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, say_note
from stadimeter.cli.known_pictures import ToneCurveOption
from stadimeter.cli.progress import count_items, working
from stadimeter.config.stereo_file import save_stereo_rig
from stadimeter.ranging.board_calibration import VIEWS_ENOUGH
from stadimeter.ranging.stereo import straight_ahead_share
from stadimeter.ranging.stereo_calibration import StereoCalibration
from stadimeter.workbench.picture_metadata import check_lens_settings
from stadimeter.workbench.stereo import find_board_pairs, pair_pictures

# Distances at which it is said how sure a target's distance will be.
_SHOWN_M = (1.0, 3.0)

# A farthest board that is less than this many times as far away as the nearest one hardly tells turn from place.
_ONE_DISTANCE = 1.3

# A distance at 3 m that is less sure than this share is nothing to rely on.
_UNSURE_SHARE = 0.02


def stereo(
    *,
    pictures: Annotated[
        list[Path],
        typer.Argument(
            metavar="LEFT... RIGHT...",
            help="Pictures of the board: first those of the left camera, then as many of the right one, in one order.",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The stereo file to write.")],
    square: Annotated[str, typer.Option("--square", metavar="LENGTH", help="Side of a square, such as 25mm.")],
    chessboard: ChessboardOption = None,
    charuco: CharucoOption = None,
    marker: MarkerOption = None,
    dictionary: DictionaryOption = None,
    square_error: Annotated[
        float,
        typer.Option(
            "--square-error",
            metavar="PERCENT",
            min=0.0,
            max=20.0,
            help="How well you know the side of a square, one standard deviation in per cent; distances are as unsure.",
        ),
    ] = 0.2,
    tone_curve: ToneCurveOption = "srgb",
) -> None:
    """Calibrate two cameras that are fixed to each other, from pictures of a board that both took at the same time.

    Take 10 to 20 pairs as for `calibrate board`: the board whole in both pictures, tilted by 30 to 45 degrees to all
    sides, near and far, and in all parts of the pictures. Hold it still, or trigger both cameras together: what moved
    between the two pictures of a pair is named and left out.

    The left camera is the one from which distances are measured; seen from behind both it is the one on the left. If
    the pictures are in two folders, or their names differ by more than their numbers, as left01.jpg and right01.jpg do,
    those are the two cameras; otherwise the first half is of the left one.

    The stereo file holds both lenses, where the right camera is, and how well all of that is known together. After that
    the cameras must not move against each other: a turn by a tenth of a degree is an error of several per cent.

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
            for note in check_lens_settings(side):
                say_note(note)
        found = find_board_pairs(
            pairs, wanted, lambda paths: count_items(paths, "looking for the board in pictures", len(paths))
        )
        for left, right, reason in found.missed:
            typer.echo(f"left out: {left}, {right}: {reason}", err=True)
        with working("calibrating"):
            made = found.calibrate(square_error / 100)
        replaced = output.exists()
        lenses = {side: replace(getattr(made.rig, side), tone_curve=tone_curve) for side in ("left", "right")}
        save_stereo_rig(output, replace(made.rig, **lenses))
        _tell(made)
        typer.echo(f"{'replaced' if replaced else 'wrote'} {output}")
    all_used = not found.missed and not any(each.why_left_out for each in made.pairs)
    raise typer.Exit(DONE if all_used else NOT_FOUND)


def _tell(made: StereoCalibration) -> None:
    name_width = max(len(f"{each.left}, {each.right}") for each in made.pairs)
    for number, each in enumerate(made.pairs, 1):
        error = "" if math.isnan(each.rms_px) else f"error {each.rms_px:.2f} px, epipolar {each.epipolar_px:.2f} px"
        left_out = f"  left out: {each.why_left_out}" if each.why_left_out else ""
        typer.echo(f"pair {number:<2}  {f'{each.left}, {each.right}':<{name_width}}  {error}{left_out}".rstrip())
    rig, used = made.rig, sum(not each.why_left_out for each in made.pairs)
    typer.echo(f"error {made.rms_px:.3f} px over {used} pairs, epipolar {made.epipolar_px:.3f} px")
    for name, lens in (("left", rig.left), ("right", rig.right)):
        share = lens.focal_relative_sigma
        typer.echo(f"{name} camera: focal length {lens.fx_px:.1f} px ± {lens.fx_px * share:.1f} ({share:.2%})")
    turned = math.degrees(math.hypot(*rig.turn_rad))
    typer.echo(
        f"the cameras are {1000 * rig.baseline_m:.2f} mm ± {1000 * rig.baseline_sigma_m:.2f} apart, and turned against "
        f"each other by {turned:.2f}°"
    )
    sure = ", ".join(f"{straight_ahead_share(rig, away_m):.2%} at {away_m:g} m" for away_m in _SHOWN_M)
    typer.echo(f"distances straight ahead are sure to {sure}, besides the noise of the pictures")
    for advice in _advice(made, used):
        say_note(advice)


def _advice(made: StereoCalibration, used: int) -> list[str]:
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
