"""The command ``locate``: where the camera was when a picture was taken, by tags of known places."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.app.bootstrap import locator_of
from stadimeter.app.messages import pose_figures
from stadimeter.cli.exits import DONE, NOT_FOUND, WRONG, configuration_path, plain_errors
from stadimeter.config.loader import load_configuration
from stadimeter.errors import ConfigError, Problem, StadimeterError
from stadimeter.workbench.measuring import open_picture


def locate(
    *,
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE", help="Picture files.")],
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="The configuration; without it, stadimeter.toml.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a line.")] = False,
) -> None:
    """Print where the camera was when a picture was taken, by tags whose places the configuration knows.

    Prints one line for each picture: x, y and z in the room (z up), yaw (where the camera looks, counter-clockwise from
    the x axis), tilt (up from level) and roll (its right side down), each with its standard deviation, and the tags
    that tell; or why it is not known. A tag that is not where the configuration says is named.

    With --json, each line is an object with file, x_m, y_m, z_m, yaw_rad, tilt_rad, roll_rad, orientation (a quaternion
    x, y, z, w of the body with x forward, y left and z up), covariance (36 numbers as in ROS's PoseWithCovariance),
    tags, moved and reason.

    **Examples**

    - `stadimeter locate lawn.jpg --config mower.toml`

    - `stadimeter locate shots/*.jpg --config mower.toml --json`

    **Exit code**: 0 every place is known; 1 one is not; 2 an option, a file or a picture is wrong. A bad picture does
    not stop the others.
    """
    with plain_errors():
        configuration = load_configuration(configuration_path(config), with_tests=False)
        locator, lens = locator_of(configuration), configuration.camera_model
        if locator is None or lens is None:
            hint = "say in [landmarks] where tags are, and in [camera] model = which lens it has; see docs/places.md"
            missing = "no section [landmarks]" if locator is None else "no camera file"
            raise ConfigError([Problem(f"there is {missing}", file=str(configuration.path), hint=hint)])
        code = DONE
        for image in images:
            try:
                frame = open_picture(image)
                pose = locator.locate(frame, lens.for_frame(frame))
            except StadimeterError as error:
                typer.echo(f"error: {error}", err=True)
                code = WRONG
                continue
            figures = {"file": str(image), **pose_figures(pose)}
            typer.echo(json.dumps(figures, ensure_ascii=False) if as_json else f"{image}: {pose.in_words()}")
            code = max(code, DONE if pose.position_m is not None else NOT_FOUND)
    raise typer.Exit(code)
