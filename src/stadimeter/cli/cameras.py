"""The command ``cameras``: those on this computer, each by the path that stays right."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.cameras.protocol import AttachedCamera, CameraMode
from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors
from stadimeter.cli.target_options import camera_choice
from stadimeter.config.plugins import DriverChoice
from stadimeter.errors import ConfigError, Problem, reason_of
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.frame_source import CameraShot
from stadimeter.workbench.run_camera import NONE_FOUND, attached_cameras, choice_of, first_picture


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(cameras)


def cameras(
    *,
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG", help="Open the cameras with the settings of this configuration.")
    ] = None,
    is_tried: Annotated[
        bool, typer.Option("--try/--no-try", help="Open each camera and take a picture, or only list them.")
    ] = True,
    folder: Annotated[
        Path | None, typer.Option("--snapshot", metavar="DIR", help="Write a picture of each camera there.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON array, for programs.")] = False,
) -> None:
    """List the cameras on this computer, each by the path that stays right.

    A number such as 0 means another camera as soon as one is plugged in elsewhere; the path that is listed does not.
    Beside it are the pixel formats, sizes and frame rates, and the lines to paste into a configuration.

    Each camera is then opened as `run` does it. Which settings it did not take is said, and whether its picture is
    black, dark, clipped or blurred. With CONFIG those are the settings of its camera. A camera in use is named as such.

    **Examples**

    - `stadimeter cameras`

    - `stadimeter cameras stadimeter.toml --snapshot pictures`

    **Exit code**: 0 every camera that is there gives pictures; 1 there is none, or one cannot be opened; 2 an option is
    wrong.
    """
    with plain_errors():
        like = camera_choice(str(config)) if config is not None else None
        _make(folder)
        seen = []
        for number, camera in enumerate(attached_cameras(), start=1):
            if not as_json:
                _list(number, camera)
            picture = folder / f"camera-{number}.png" if folder is not None else None
            seen.append(_check_camera(camera, like, picture, is_tried=is_tried or folder is not None))
            if not as_json:
                _tell(seen[-1])
        if as_json:
            typer.echo(json.dumps([each.record() for each in seen], indent=2))
        if not seen:
            typer.echo(f"error: {NONE_FOUND}", err=True)
    raise typer.Exit(DONE if seen and not any(each.trouble for each in seen) else NOT_FOUND)


@dataclass(frozen=True, slots=True, kw_only=True)
class _CheckedCamera:
    """A camera, and what became of it: a picture, why there is none, or neither if it was not opened."""

    camera: AttachedCamera
    trouble: str
    shot: CameraShot | None = None
    picture: Path | None = None

    def record(self) -> dict[str, Any]:
        """Return it as the object that ``--json`` prints."""
        return {
            "name": self.camera.name,
            "driver": self.camera.driver,
            "device": self.camera.path,
            "node": self.camera.node,
            "live": self.camera.choice,
            "modes": [asdict(mode) for mode in self.camera.modes],
            "trouble": self.trouble,
            "width_px": self.shot and self.shot.frame.width_px,
            "height_px": self.shot and self.shot.frame.height_px,
            "settings_not_taken": self.shot and self.shot.settings,
            "faults": self.shot and self.shot.faults,
            "picture": self.picture and str(self.picture),
        }


def _make(folder: Path | None) -> None:
    try:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            [Problem(f"the folder {folder} cannot be made: {reason_of(error)}", key="--snapshot")]
        ) from error


def _check_camera(
    camera: AttachedCamera, like: DriverChoice | None, picture: Path | None, *, is_tried: bool
) -> _CheckedCamera:
    if camera.trouble or not is_tried:
        return _CheckedCamera(camera=camera, trouble=camera.trouble)
    typer.echo(f"opening {camera.name} …", err=True)
    shot = first_picture(choice_of(camera, like))
    if isinstance(shot, str):
        return _CheckedCamera(camera=camera, trouble=shot)
    if picture is not None:
        write_picture(picture, shot.frame.image, shot.frame.optics)
    return _CheckedCamera(camera=camera, trouble="", shot=shot, picture=picture)


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


def _tell(seen: _CheckedCamera) -> None:
    if seen.trouble:
        typer.echo(f"   cannot be used: {seen.trouble}")
    if seen.shot is None:
        return
    took = "; ".join(seen.shot.settings) or "it took every setting"
    typer.echo(f"   gives {seen.shot.frame.width_px} × {seen.shot.frame.height_px}: {took}")
    for fault in seen.shot.faults:
        typer.echo(f"   {fault}")
    if seen.picture is not None:
        typer.echo(f"   wrote {seen.picture}")
