"""The command ``colour``: the range of colours of a ball, from pictures and places in them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, say_note, working
from stadimeter.cli.measure import copy_paths
from stadimeter.cli.target_options import LiveOption, camera_choice
from stadimeter.core.detection import DetectionStatus
from stadimeter.detectors.protocol import ColourProposal, ColourSample, ColourView
from stadimeter.errors import ConfigError
from stadimeter.workbench import colour_aids
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.frame_source import take_frame
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.picture_metadata import picture_remarks, profile_notes
from stadimeter.workbench.setup.colour_step import ball_colours

COLOURLESS = "a ball without a colour of its own, such as a silver or a white one, is measured by its edge: give none"


def colour(
    *,
    pictures: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="PICTURE[@X,Y…]", help="Pictures of the ball, and places on it: ball.jpg or ball.jpg@312,240."
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option("--at", metavar="X,Y", help="A place on the ball, in pixels of the only picture. Several join."),
    ] = None,
    live: LiveOption = None,
    copies: Annotated[
        Path | None, typer.Option("--annotate", metavar="DIR", help="Folder for copies that show the range.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find the range of a ball's colours, from a picture and a place in it.

    Point at the ball with --at, as a picture viewer shows the place under the pointer: x to the right and y down.
    Without a place, the roundest thing with a colour of its own is proposed. Several places on the ball join into one
    range, and so do several pictures in several lights.

    Prints the line `hsv = "…"` for the ball's table in a configuration; what else in the picture has that colour; and
    how many hues there are to the next thing. With --annotate, writes a copy of each picture into that folder as
    NAME-colour.png, in which what has the colour stands out.

    With --json, one object: hsv, hue_margin (null where no other thing has a hue near it), and pictures, a list of
    objects with file, copy (null without --annotate), status (found, truncated or not_found), is_where_pointed,
    centre_px, width_px, reason, and others, each with centre_px and size_px.

    **Examples**

    - `stadimeter colour ball.jpg`

    - `stadimeter colour ball.jpg --at 312,240 --at 330,262`

    - `stadimeter colour noon.jpg@312,240 dusk.jpg@290,255 --annotate shown`

    - `stadimeter colour --live opencv,device=0`

    **Exit code**: 0 the ball is found with the range in every picture; 1 not in every one; 2 an option or a picture is
    wrong.
    """
    with plain_errors():
        with working("looking for a ball of one colour"):
            names, samples = _samples_from_options(pictures or [], at or [], live)
            proposal = ball_colours().propose_colour(samples)
        if proposal is None:
            raise ConfigError(_nothing(samples))
        paths = copy_paths(names, copies, "colour")
        if not as_json:
            _print(names, samples, proposal)
        for name, sample, view in zip(names, samples, proposal.views, strict=True):
            if name in paths:
                write_picture(paths[name], colour_aids.colour_picture(sample.frame.image, view, proposal.colour))
                if not as_json:
                    typer.echo(f"written: {paths[name]}")
        if as_json:
            typer.echo(json.dumps(_record(names, paths, samples, proposal), ensure_ascii=False))
        is_found = all(map(colour_aids.is_where_pointed, samples, proposal.views))
        if not is_found:
            say_note(COLOURLESS)
    raise typer.Exit(DONE if is_found else NOT_FOUND)


def _samples_from_options(
    pictures: Sequence[str], at: Sequence[str], live: str | None
) -> tuple[list[Path], list[ColourSample]]:
    """Return the pictures by name, each with the places in it."""
    if bool(pictures) == bool(live):
        raise ConfigError("give pictures of the ball, or --live for a camera, one of the two")
    if at and len(pictures) > 1:
        raise ConfigError("--at is a place in one picture; for several write such as noon.jpg@312,240 dusk.jpg@290,255")
    if live:
        frame = take_frame(camera_choice(live))
        for words in picture_remarks(frame.image):
            say_note(words)
        return [Path("live.png")], [colour_aids.colour_sample(frame, "the camera's picture", at, "--at")]
    split = [colour_aids.split_places(each) for each in pictures]
    names = [Path(name) for name, _ in split]
    for note in profile_notes(names):
        say_note(note)
    samples = [
        colour_aids.colour_sample(open_picture(Path(name)), name, [*places, *at], "--at") for name, places in split
    ]
    return names, samples


def _nothing(samples: Sequence[ColourSample]) -> str:
    if any(sample.places_px for sample in samples):
        return colour_aids.ONLY_BACKGROUND
    return f"{colour_aids.NOTHING_STANDS_OUT}; point at it with --at X,Y, in pixels; {COLOURLESS}"


def _print(names: Sequence[Path], samples: Sequence[ColourSample], proposal: ColourProposal) -> None:
    for name, sample, view in zip(names, samples, proposal.views, strict=True):
        elsewhere = (
            ""
            if colour_aids.is_where_pointed(sample, view) or not len(view.detection.outline_px)
            else ", not where you point"
        )
        typer.echo(f"{name}: {_in_words(view)}{elsewhere}")
        for number, other in enumerate(view.others, start=1):
            x_px, y_px = other.centre_px
            typer.echo(
                f"    {number}: something else has that colour, at {x_px:.0f},{y_px:.0f}, {other.size_px:.0f} px"
            )
    typer.echo(f'hsv = "{proposal.colour}"')
    if proposal.hue_margin is None:
        typer.echo("margin: no other thing has a hue near it")
    else:
        typer.echo(f"margin: {proposal.hue_margin} more hues (of 180) at each end, then another thing has it as well")


def _record(
    names: Sequence[Path], paths: Mapping[Path, Path], samples: Sequence[ColourSample], proposal: ColourProposal
) -> dict[str, object]:
    """Return the object that ``--json`` prints."""
    pictures = []
    for name, sample, view in zip(names, samples, proposal.views, strict=True):
        found = view.detection
        is_seen = found.status is not DetectionStatus.NOT_FOUND
        pictures.append(
            {
                "file": str(name),
                "copy": str(paths[name]) if name in paths else None,
                "status": found.status.value,
                "is_where_pointed": colour_aids.is_where_pointed(sample, view),
                "centre_px": found.centre_px if is_seen else None,
                "width_px": found.width_px if is_seen else None,
                "reason": found.reason,
                "others": [{"centre_px": other.centre_px, "size_px": other.size_px} for other in view.others],
            }
        )
    return {"hsv": proposal.colour, "hue_margin": proposal.hue_margin, "pictures": pictures}


def _in_words(view: ColourView) -> str:
    found = view.detection
    if found.status is DetectionStatus.NOT_FOUND:
        return f"no ball is found with this range: {found.reason}"
    x_px, y_px = found.centre_px
    cut = ", cut off by the border" if found.status is DetectionStatus.TRUNCATED else ""
    return f"a ball at {x_px:.0f},{y_px:.0f}, {found.width_px:.0f} px across{cut}"
