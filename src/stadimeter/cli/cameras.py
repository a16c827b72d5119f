"""The commands ``cameras`` and ``snapshot``: the cameras on this computer, and pictures with the settings of `run`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import groupby, islice
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.exact_json import plain
from stadimeter.cameras.protocol import AttachedCamera, CameraMode
from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, read_option, say_note
from stadimeter.cli.target_options import LiveOption, camera_choice
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import parse_duration
from stadimeter.errors import ConfigError
from stadimeter.workbench import frame_source
from stadimeter.workbench.annotation import write_picture


def cameras(
    *,
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG", help="Open the cameras with the settings of this configuration.")
    ] = None,
    is_tried: Annotated[
        bool, typer.Option("--try/--no-try", help="Open each camera and take a picture, or only list them.")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON array, for programs.")] = False,
) -> None:
    """List the cameras on this computer, each by a path that survives reboots.

    A number such as 0 means another camera as soon as one is plugged in elsewhere; the path that is listed does not.
    Beside it are the pixel formats, sizes and frame rates, and the lines to paste into a configuration.

    Each camera is then opened as `run` does it. Which settings it did not take is said, and whether its picture is
    black, dark, clipped or blurred. With CONFIG those are the settings of its camera. A camera in use is named as such.

    **Examples**

    - `stadimeter cameras`

    - `stadimeter cameras stadimeter.toml`

    **Exit code**: 0 every camera that is there gives pictures; 1 there is none, or one cannot be opened; 2 an option is
    wrong.
    """
    with plain_errors():
        like = camera_choice(str(config)) if config is not None else None
        records = []
        for number, camera in enumerate(frame_source.list_cameras(), start=1):
            if not as_json:
                _list(number, camera)
            trouble, shot = _try(camera, like) if is_tried else (camera.trouble, None)
            records.append(_record(camera, trouble, shot))
            if not as_json:
                _tell(trouble, shot)
        if as_json:
            typer.echo(json.dumps(records, indent=2))
        if not records:
            typer.echo(f"error: {frame_source.NONE_FOUND}", err=True)
    raise typer.Exit(DONE if records and not any(each["trouble"] for each in records) else NOT_FOUND)


def _try(camera: AttachedCamera, like: DriverChoice | None) -> tuple[str, frame_source.CameraShot | None]:
    """Open a camera; return why it gives no picture, or empty and the picture."""
    if camera.trouble:
        return camera.trouble, None
    typer.echo(f"opening {camera.name} …", err=True)
    shot = frame_source.first_picture(frame_source.choice_of(camera, like))
    return (shot, None) if isinstance(shot, str) else ("", shot)


def _record(camera: AttachedCamera, trouble: str, shot: frame_source.CameraShot | None) -> dict[str, Any]:
    """Return a camera as the object that ``--json`` prints."""
    return {
        "name": camera.name,
        "driver": camera.driver,
        "device": camera.path,
        "node": camera.node,
        "live": camera.choice,
        "modes": [plain(mode) for mode in camera.modes],
        "trouble": trouble,
        "width_px": shot and shot.frame.width_px,
        "height_px": shot and shot.frame.height_px,
        "settings_not_taken": shot and shot.settings,
        "faults": shot and shot.faults,
    }


def _list(number: int, camera: AttachedCamera) -> None:
    typer.echo(f"{number}  {camera.name}, now {camera.node}")
    table = {"driver": camera.driver, **camera.options}
    for line in (*(f'{key} = "{value}"' for key, value in table.items() if value is not None), *_modes(camera.modes)):
        typer.echo(f"   {line}")


def _modes(modes: Sequence[CameraMode]) -> Iterator[str]:
    """Yield a line for each pixel format: its sizes, each with its highest frame rate."""
    for fourcc, of_format in groupby(modes, key=lambda mode: mode.fourcc):
        sizes = (
            f"{mode.width_px} × {mode.height_px}" + (f" at {mode.rates_hz[0]:g} Hz" if mode.rates_hz else "")
            for mode in of_format
        )
        yield f"{fourcc.strip()}: {', '.join(sizes)}"


def _tell(trouble: str, shot: frame_source.CameraShot | None) -> None:
    if trouble:
        typer.echo(f"   cannot be used: {trouble}")
    if shot is not None:
        took = "; ".join(shot.settings) or "it took every setting"
        typer.echo(f"   gives {shot.frame.width_px} × {shot.frame.height_px}: {took}")
        for fault in shot.faults:
            typer.echo(f"   {fault}")


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
    """Take a picture with the settings that `run` uses.

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
        with closing(frame_source.snapshots(choice, apart_s=read_option(parse_duration, every, "--every"))) as taken:
            for number, each in enumerate(islice(taken, count), start=1):
                path = output if count == 1 else output.with_stem(f"{output.stem}-{number}")
                write_picture(path, each.frame.image, each.frame.optics)
                _say(path, each, is_first=number == 1, as_json=as_json)
                written, is_good = number, is_good and not each.faults
        if written < count:
            raise ConfigError(f"the camera came to an end after {written} of {count} pictures")
        say_note(frame_source.OTHER_PROGRAMS)
    raise typer.Exit(DONE if is_good else NOT_FOUND)


def _say(path: Path, taken: frame_source.CameraShot, *, is_first: bool, as_json: bool) -> None:
    size = {"width_px": taken.frame.width_px, "height_px": taken.frame.height_px}
    if as_json:
        record = {"file": str(path), **size, "settings": taken.settings, "faults": taken.faults}
        typer.echo(json.dumps(record, ensure_ascii=False))
        return
    typer.echo(f"wrote {path}: {size['width_px']} × {size['height_px']} pixels")
    for words in (*(taken.settings if is_first else ()), *taken.faults):
        say_note(words)
