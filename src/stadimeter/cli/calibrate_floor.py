"""The command ``calibrate floor``: how high the camera is above the floor and how far it is tilted."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.app.detectors import build_detectors
from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, say_note
from stadimeter.cli.target_options import GivenTarget, takes_target, targets_from_options
from stadimeter.config.camera_file import load_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.flat import SheetShape, TagShape
from stadimeter.ranging.floor_pose import CameraAboveFloor, camera_above, mean_of
from stadimeter.workbench.measuring import open_picture

# A camera that is rolled by more is noted: what is 20 degrees aside then seems off in tilt by a third of that.
MUCH_ROLL_RAD = math.radians(0.5)


@takes_target
def floor(
    *,
    target: GivenTarget,
    pictures: Annotated[list[Path], typer.Argument(metavar="IMAGE", help="Pictures of a tag or sheet on the floor.")],
    camera: Annotated[Path, typer.Option("--camera", metavar="FILE", help="The camera file.")],
) -> None:
    """Find out how high the camera is above the floor and how far it is tilted.

    Lay a tag or a sheet of known size flat on the floor before the camera, as near as it is seen whole, and take a
    picture. Prints the lines for `[camera]` in a configuration, with which targets that have `on_floor` are measured by
    the floor as well. Several pictures, with the tag in other places, show how level the floor is.

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
        views = [view for path in pictures if (view := _look(path, detector, shape, model)) is not None]
        if not views:
            typer.echo("error: no picture can be used", err=True)
            raise typer.Exit(NOT_FOUND)
        _print_lines(mean_of(views))
    raise typer.Exit(DONE if len(views) == len(pictures) else NOT_FOUND)


def _look(path: Path, detector: Detector, shape: SheetShape | TagShape, model: CameraModel) -> CameraAboveFloor | None:
    """Return the result of one picture, or say on standard error why it cannot be used."""
    frame = open_picture(path)
    lens = model.for_frame(frame)
    found = detector.detect(frame, lens=lens)
    reason = found.reason
    if found.status is DetectionStatus.FOUND:
        try:
            view = camera_above(found, shape, lens)
        except CalibrationError as error:
            reason = str(error)
        else:
            typer.echo(f"{path}  {_words(view)}")
            return view
    typer.echo(f"left out: {path}: {reason}", err=True)
    return None


def _words(view: CameraAboveFloor) -> str:
    height = f"{100 * view.height_m:.1f} cm ± {100 * view.height_sigma_m:.1f}"
    tilt = f"{math.degrees(view.tilt_rad):.2f}° ± {math.degrees(view.tilt_sigma_rad):.2f}"
    return f"{height} above the floor, tilt {tilt}"


def _print_lines(view: CameraAboveFloor) -> None:
    if abs(view.roll_rad) > MUCH_ROLL_RAD:
        side = "right" if view.roll_rad > 0 else "left"
        degrees = abs(math.degrees(view.roll_rad))
        say_note(f"the camera's {side} side is {degrees:.1f}° down; level it, since only its tilt is allowed for")
    height_mm, tilt_deg = 1000 * view.height_sigma_m, math.degrees(view.tilt_sigma_rad)
    typer.echo("[camera]")
    typer.echo(f'height = "{100 * view.height_m:.2f} cm ± {max(height_mm, 0.1):.1f} mm"')
    typer.echo(f'tilt = "{math.degrees(view.tilt_rad):.2f} deg ± {max(tilt_deg, 0.01):.2f} deg"')
