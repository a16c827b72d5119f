"""The command ``colour``: the range of colours of a ball, from pictures and places in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors
from stadimeter.cli.explanation import copy_paths
from stadimeter.cli.live_camera import LiveOption, camera_choice
from stadimeter.config.plugins import DETECTORS, load_plugin
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import ColourProposal, ColourSample, ColourView
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.colour_picture import colour_picture
from stadimeter.workbench.colour_profile import profile_notes
from stadimeter.workbench.frame_source import settled_frame
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.picture_quality import picture_remarks

Place = tuple[float, float]


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(colour)


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
        Path, typer.Option("--annotate", metavar="DIR", help="Folder for the pictures that show the range.")
    ] = Path(),
) -> None:
    """Find out the range of colours of a ball, from a picture and a place in it.

    Point at the ball with --at, as a picture viewer shows the place under the pointer: x to the right and y down.
    Without a place, the roundest thing with a colour of its own is proposed. Several places on the ball join into one
    range, and so do several pictures in several lights.

    Prints the line `hsv = "…"` for the ball's table in a configuration; what else in the picture has that colour; and
    how many hues there are to the next thing. Writes a copy of each picture as NAME-colour.png, in which what has the
    colour stands out.

    **Examples**

    - `stadimeter colour ball.jpg`

    - `stadimeter colour ball.jpg --at 312,240 --at 330,262`

    - `stadimeter colour noon.jpg@312,240 dusk.jpg@290,255 --annotate shown`

    - `stadimeter colour --live opencv,device=0`

    **Exit code**: 0 the ball is found with the range in every picture; 1 not in every one; 2 an option or a picture is
    wrong.
    """
    with plain_errors():
        names, samples = _given(pictures or [], at or [], live)
        found = load_plugin(DETECTORS, "ball").propose_colour
        proposal: ColourProposal | None = found(samples) if found else None
        if proposal is None:
            raise ConfigError(_nothing(samples))
        _print(names, samples, proposal)
        paths = copy_paths(names, copies, "colour")
        for name, sample, view in zip(names, samples, proposal.views, strict=True):
            write_picture(paths[name], colour_picture(sample.frame.image, view, proposal.colour))
            typer.echo(f"written: {paths[name]}")
        is_found = all(map(_is_there, samples, proposal.views))
    raise typer.Exit(DONE if is_found else NOT_FOUND)


def _given(pictures: Sequence[str], at: Sequence[str], live: str | None) -> tuple[list[Path], list[ColourSample]]:
    """Return the pictures by name, each with the places in it."""
    if bool(pictures) == bool(live):
        raise ConfigError("give pictures of the ball, or --live for a camera, one of the two")
    if at and len(pictures) > 1:
        raise ConfigError("--at is a place in one picture; for several write such as noon.jpg@312,240 dusk.jpg@290,255")
    if live:
        frame = settled_frame(camera_choice(live))
        for words in picture_remarks(frame.image):
            typer.echo(f"note: {words}", err=True)
        return [Path("live.png")], [_sample(frame, "the camera's picture", at)]
    split = [_split(each) for each in pictures]
    names = [Path(name) for name, _ in split]
    for note in profile_notes(names):
        typer.echo(f"note: {note}", err=True)
    samples = [_sample(open_picture(Path(name)), name, [*places, *at]) for name, places in split]
    return names, samples


def _split(text: str) -> tuple[str, list[str]]:
    """Return the path and the places of ``PATH@X,Y@X,Y``; a path may hold an ``@`` itself."""
    name, places = text, []
    while "@" in name and not Path(name).is_file():
        name, _, place = name.rpartition("@")
        places.append(place)
    return (name, places) if Path(name).is_file() else (text, [])


def _sample(frame: Frame, name: str, places: Sequence[str]) -> ColourSample:
    return ColourSample(frame, tuple(_place(each, name, frame) for each in places))


def _place(text: str, name: str, frame: Frame) -> Place:
    x, _, y = text.partition(",")
    try:
        place = float(x), float(y)
    except ValueError as error:
        raise ConfigError([Problem(f"{text!r} is not a place; write it such as 312,240", key="--at")]) from error
    if not (0 <= place[0] < frame.width_px and 0 <= place[1] < frame.height_px):
        size = f"{frame.width_px} × {frame.height_px} pixels"
        raise ConfigError([Problem(f"{text} is not in {name}, which has {size}", key="--at")])
    return place


def _nothing(samples: Sequence[ColourSample]) -> str:
    if any(sample.places_px for sample in samples):
        return "what you point at has no outline of its own: it is background; point at the middle of the ball"
    return "nothing in the picture stands out as a ball of one colour; point at it with --at X,Y, in pixels"


def _is_there(sample: ColourSample, view: ColourView) -> bool:
    """Return whether a ball is seen, and where the person has pointed."""
    seen = view.detection
    if seen.status is DetectionStatus.NOT_FOUND:
        return False
    reach_px = seen.width_px / 2
    return not sample.places_px or any(math.dist(seen.centre_px, each) <= reach_px for each in sample.places_px)


def _print(names: Sequence[Path], samples: Sequence[ColourSample], proposal: ColourProposal) -> None:
    for name, sample, view in zip(names, samples, proposal.views, strict=True):
        elsewhere = "" if _is_there(sample, view) or not len(view.detection.outline_px) else ", not where you point"
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


def _in_words(view: ColourView) -> str:
    found = view.detection
    if found.status is DetectionStatus.NOT_FOUND:
        return f"no ball is found with this range: {found.reason}"
    x_px, y_px = found.centre_px
    cut = ", cut off by the border" if found.status is DetectionStatus.TRUNCATED else ""
    return f"a ball at {x_px:.0f},{y_px:.0f}, {found.width_px:.0f} px across{cut}"
