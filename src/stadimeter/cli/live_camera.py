"""The option ``--live``: a camera, named by a configuration or by its driver."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from stadimeter.config.findings import findings_of
from stadimeter.config.plugins import CAMERAS, DriverChoice, load_driver
from stadimeter.config.toml_source import camera_table
from stadimeter.config.untrusted_file import is_file
from stadimeter.errors import ConfigError, Problem

LiveOption = Annotated[
    str | None,
    typer.Option(
        "--live",
        metavar="CONFIG|DEVICE|DRIVER",
        help="Take what a camera sees: that of a configuration; a device such as 0 or one that `stadimeter cameras` "
        "lists; or a driver with its options, such as opencv,device=0,exposure=10ms.",
    ),
]


def camera_choice(live: str) -> DriverChoice:
    """Return the camera of a configuration, a device, or a camera driver with its options, such as ``opencv,device=0``.

    Raises:
        ConfigError: There is no such configuration, or an option is wrong.
        DriverError: There is no such driver.
    """
    if Path(live).suffix.lower() == ".toml" or is_file(Path(live)):
        from stadimeter.config.loader import load_camera_choice  # noqa: PLC0415 - most of a start, and rarely needed

        return load_camera_choice(Path(live))
    table = camera_table(live)
    driver = table.pop("driver")
    model = load_driver(CAMERAS, driver)
    try:
        return DriverChoice(name="camera", driver=driver, options=model.model_validate(table))
    except ValidationError as error:
        found = findings_of(error, model, table, ())
        hint = f"write it such as --live {driver},KEY=VALUE, or write a configuration and give that"
        raise ConfigError([Problem(f"{driver}: {each.message}", key="--live", hint=hint) for each in found]) from error
