"""The argument CONFIG of commands that need a configuration: where none is named, the one in this folder is meant."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stadimeter.errors import ConfigError

USUAL = Path("stadimeter.toml")
"""The configuration that `stadimeter init` writes."""

ConfigArgument = Annotated[
    Path | None,
    typer.Argument(metavar="[CONFIG]", help=f"The configuration, a TOML file; without it, {USUAL} in this folder."),
]


def configuration_path(named: Path | None) -> Path:
    """Return the configuration that is meant, and say on standard error which one that is if it was not named.

    Raises:
        ConfigError: None was named, and there is none in this folder.
    """
    if named is not None:
        return named
    if not USUAL.is_file():
        raise ConfigError(
            f"name a configuration: there is no {USUAL} in this folder. `stadimeter init` writes one, and "
            "`stadimeter demo` needs none"
        )
    typer.echo(f"using {USUAL}", err=True)
    return USUAL
