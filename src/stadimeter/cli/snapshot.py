"""The command ``snapshot``: pictures of a camera with exactly the settings that ``run`` uses."""

from __future__ import annotations

import json
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors
from stadimeter.cli.target_options import LiveOption, camera_choice
from stadimeter.config.units import parse_duration
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.frame_source import OTHER_PROGRAMS, CameraShot, snapshots


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(snapshot)


def snapshot(
    *,
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG", help="The configuration whose camera to take.")
    ] = None,
    live: LiveOption = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The picture to write; the ending says the kind.")
    ] = Path("snapshot.png"),
    count: Annotated[
        int, typer.Option("--count", min=1, max=10_000, help="How many pictures: FILE-1, FILE-2 and so on.")
    ] = 1,
    every: Annotated[
        str, typer.Option("--every", metavar="TIME", help="With --count: how long from one to the next.")
    ] = "1s",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object for each picture.")] = False,
) -> None:
    """Take a picture with exactly the settings that `run` uses.

    Focus and exposure are those of the configuration, so the picture shows what `run` will see, and it can calibrate
    the camera. A photograph by another program may have another focus, another zoom and another size, and therefore
    another focal length.

    Says which settings the camera did not take, and whether the picture is black, dark, clipped to white or blurred.
    With --json, each picture is an object with file, width_px, height_px, settings and faults.

    **Examples**

    - `stadimeter snapshot stadimeter.toml -o ball.png`

    - `stadimeter snapshot --live opencv,device=0 -o board.png --count 15 --every 2s`

    **Exit code**: 0 the pictures are written; 1 they are written, and one of them is black, dark, clipped or blurred;
    2 an option is wrong, the camera gives no picture, or one cannot be written.
    """
    with plain_errors():
        if (config is None) == (live is None):
            raise ConfigError("give a configuration, or --live for a camera, one of the two")
        choice = camera_choice(live if live is not None else str(config))
        written, is_good = 0, True
        with closing(snapshots(choice, apart_s=_seconds(every))) as taken:
            for number, each in enumerate(islice(taken, count), start=1):
                path = output if count == 1 else output.with_stem(f"{output.stem}-{number}")
                write_picture(path, each.frame.image, each.frame.optics)
                _say(path, each, is_first=number == 1, as_json=as_json)
                written, is_good = number, is_good and not each.faults
        if written < count:
            raise ConfigError(f"the camera came to an end after {written} of {count} pictures")
        typer.echo(f"note: {OTHER_PROGRAMS}", err=True)
    raise typer.Exit(DONE if is_good else NOT_FOUND)


def _say(path: Path, taken: CameraShot, *, is_first: bool, as_json: bool) -> None:
    size = {"width_px": taken.frame.width_px, "height_px": taken.frame.height_px}
    if as_json:
        record = {"file": str(path), **size, "settings": taken.settings, "faults": taken.faults}
        typer.echo(json.dumps(record, ensure_ascii=False))
        return
    typer.echo(f"wrote {path}: {size['width_px']} × {size['height_px']} pixels")
    for words in (*(taken.settings if is_first else ()), *taken.faults):
        typer.echo(f"note: {words}", err=True)


def _seconds(every: str) -> float:
    try:
        return parse_duration(every)
    except ValueError as error:
        raise ConfigError([Problem(str(error), key="--every")]) from error
