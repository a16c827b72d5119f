"""The command ``wiring``: what hangs on which pin of the Raspberry Pi."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import ConfigArgument, configuration_path, plain_errors
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import DriverChoice
from stadimeter.errors import ConfigError
from stadimeter.workbench.drawing import write_drawings
from stadimeter.workbench.wiring.circuits import find_outputs, parts_of
from stadimeter.workbench.wiring.drawings import wiring_picture, wiring_text


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(wiring)


def wiring(
    config: ConfigArgument = None,
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Draw it into this file, .svg or .pdf.")
    ] = None,
) -> None:
    """Draw what hangs on which pin of the Raspberry Pi, from a configuration.

    Shows the 40 pins of the header, those that the configuration uses, and the circuit of each part: a motor or a
    buzzer on a transistor, an LED with its resistor, a relay board, a button. Warns of pins that the Pi itself uses.

    A base has a serial port of its own, and is not on the header.

    **Examples**

    - `stadimeter wiring config/distance-alert.toml`

    - `stadimeter wiring config/distance-alert.toml -o wiring.svg`

    **Exit code**: 0 done; 2 the configuration cannot be used, nothing is on a pin, or the file cannot be written.
    """
    with plain_errors():
        configuration = load_configuration(configuration_path(config))
        parts = parts_of(configuration)
        if not find_outputs(parts):
            raise ConfigError(f"{configuration.path}: no part is on a pin of the header, so there is nothing to wire")
        for warning in configuration.warnings:
            if warning.code == "pin-taken":
                typer.echo(f"warning: {warning}", err=True)
        if output is None:
            typer.echo(_text(parts))
        else:
            write_drawings(output, [wiring_picture(parts)])
            typer.echo(f"wrote {output}")


def _text(parts: tuple[DriverChoice, ...]) -> str:
    return wiring_text(
        parts,
        width=shutil.get_terminal_size().columns,
        ascii_only="utf" not in (sys.stdout.encoding or "").lower(),
    )
