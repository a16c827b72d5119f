"""``measure --at``: how large what is seen is, if its distance is known; of a target, or of a box that is given."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import DONE
from stadimeter.cli.formatting import METRE, LengthUnit, format_distance
from stadimeter.cli.target_options import GivenTarget
from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.units import parse_known, parse_length
from stadimeter.errors import ConfigError, Problem
from stadimeter.ranging.calibration import DISTANCE_RELATIVE_SIGMA
from stadimeter.ranging.size_at import DrawnBox, SizeAt, box_size_at, size_at
from stadimeter.workbench.measuring import TargetResult, open_picture

AtOption = Annotated[
    str | None,
    typer.Option(
        "--at",
        metavar="DISTANCE",
        help="Print how large the target is if it is that far away, such as 2m or '2m ± 1cm'; 1 % of it without ±.",
    ),
]
BoxOption = Annotated[
    str | None,
    typer.Option(
        "--box",
        metavar="X,Y,W,H",
        help="With --at: how large what fills this box is, in pixels, left top corner first. In place of a target.",
    ),
]


def parse_at(text: str) -> tuple[float, float]:
    """Read ``--at``; return the distance and its standard deviation in metres.

    Raises:
        ConfigError: It is no length above zero.
    """
    try:
        at = parse_known(text, parse_length, parse_length)
    except ValueError as error:
        raise ConfigError([Problem(str(error), key="--at", hint="write it such as 2m or '2m ± 1cm'")]) from error
    return at.value, DISTANCE_RELATIVE_SIGMA * at.value if at.sigma is None else at.sigma


def parse_box(text: str) -> DrawnBox:
    """Read ``--box``; `ConfigError` if it is no box."""
    hint = "write it such as 120,80,200,150: left top corner, width and height"
    try:
        x_px, y_px, width_px, height_px = map(float, text.split(","))
    except ValueError as error:
        raise ConfigError([Problem(f"{text!r} is not four numbers", key="--box", hint=hint)]) from error
    if not (0 <= x_px < 1e6 and 0 <= y_px < 1e6 and 0 < width_px < 1e6 and 0 < height_px < 1e6):
        raise ConfigError([Problem(f"{text!r} is no box with a width and a height", key="--box", hint=hint)])
    return DrawnBox(x_px, y_px, width_px, height_px)


def check_box_alone(given: GivenTarget, config: Path | None) -> None:
    """Raise a `ConfigError` where there is a target beside ``--box``."""
    if any(value is not None and value != "auto" for value in given.values()) or config is not None:
        raise ConfigError("--box is measured in place of a target; give one of them")


def measure_boxes(
    images: Sequence[Path], camera_file: Path | None, text: str, at: tuple[float, float] | None, *, as_json: bool
) -> int:
    """Print how large what fills a box is in each picture; return the exit code.

    Raises:
        ConfigError: Something that it needs is missing or wrong, or the box reaches out of a picture.
        PictureError: A picture cannot be read.
    """
    if at is None:
        raise ConfigError("--box has a size only at a known distance; add such as --at 2m")
    if not images or camera_file is None:
        raise ConfigError("--box needs pictures, and the camera file with --camera")
    box, camera = parse_box(text), load_camera_model(camera_file)
    for image in images:
        frame = open_picture(image)
        if box.x_px + box.width_px > frame.width_px or box.y_px + box.height_px > frame.height_px:
            hint = f"the picture {image} has {frame.width_px}x{frame.height_px} px"
            raise ConfigError([Problem("the box reaches out of the picture", key="--box", hint=hint)])
        print_size(str(image), "box", box_size_at(box, camera.for_frame(frame), at), at[0], METRE, as_json=as_json)
    return DONE


def target_size(result: TargetResult, at: tuple[float, float]) -> SizeAt | None:
    """Return the size of a target that was measured by its size; None for one that was not."""
    seen, found = result.seen, result.detection
    if seen is None or found is None or result.parts is None:
        return None
    measured = seen.measurement if result.floor is None else result.floor.by_size
    return size_at(measured, result.parts, seen.shape, found.height_px > found.width_px, at)


def print_size(file: str, name: str, size: SizeAt | None, at_m: float, unit: LengthUnit, *, as_json: bool) -> None:
    """Print width and height, as a line or as an object."""
    if as_json:
        figures = {each: getattr(size, each, None) for each in SizeAt.__struct_fields__}
        typer.echo(json.dumps({"file": file, "target": name, "at_m": at_m, **figures}))
    elif size is None:
        typer.echo(f"{file}  {name}  size at {format_distance(at_m, None, unit)}: unknown, it is not measured")
    else:
        width = format_distance(size.width_m, size.width_sigma_m, unit)
        height = format_distance(size.height_m, size.height_sigma_m, unit)
        typer.echo(f"{file}  {name}  at {format_distance(at_m, None, unit)}: {width} wide, {height} high")
