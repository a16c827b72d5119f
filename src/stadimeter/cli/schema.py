"""The command ``schema``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import plain_errors
from stadimeter.config.atomic_file import write_atomically
from stadimeter.config.schema import configuration_schema
from stadimeter.errors import ConfigError, Problem, reason_of


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(schema)


def schema(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write it to this file instead of printing it."),
    ] = None,
) -> None:
    """Print a JSON Schema of configurations, for editors that complete and check while you write.

    It knows every driver that is installed here, and its keys. Put a first line into the configuration, and editors
    with a TOML language server, such as Visual Studio Code with Even Better TOML, use it:

    `#:schema ./stadimeter.schema.json`

    What only the whole configuration can tell, `stadimeter check` finds.

    **Example**

    - `stadimeter schema -o stadimeter.schema.json`

    **Exit code**: 0 done; 2 the file cannot be written.
    """
    text = json.dumps(configuration_schema(), indent=2, ensure_ascii=False)
    if output is None:
        typer.echo(text)
        return
    with plain_errors():
        _write(output, f"{text}\n")


def _write(file: Path, text: str) -> None:
    try:
        write_atomically(file, text.encode())
    except OSError as error:
        raise ConfigError([Problem(f"it cannot be written: {reason_of(error)}", str(file))]) from error
