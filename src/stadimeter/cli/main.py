"""The command ``stadimeter``."""

from __future__ import annotations

import typer

app = typer.Typer(name="stadimeter", no_args_is_help=True, pretty_exceptions_enable=False)


def main() -> None:
    """Run the command line and leave the process with its exit code."""
    app()
