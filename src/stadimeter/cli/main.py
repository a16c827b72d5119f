"""The command ``stadimeter``: one place that knows every group of commands."""

from __future__ import annotations

from typing import Annotated

import typer

import stadimeter
from stadimeter.cli import calibrate, check, measure, replay, run

app = typer.Typer(
    name="stadimeter",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"stadimeter {stadimeter.__version__}")
        raise typer.Exit


@app.callback()
def _stadimeter(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Turn a camera into a rangefinder that acts.

    Watches an object of known size (a ball, a sheet of paper), measures how far away it is and how sure that is, and
    lets rules turn distance into action: vibrate, beep, follow, alert.

    Start with `stadimeter demo`, which needs no hardware. Then `calibrate` the camera with one picture at a known
    distance, `measure` some pictures, `check` a configuration and `run` it.
    """


for group in (run, measure, calibrate, check, replay):
    group.register(app)


def main() -> None:
    """Run the command line and leave the process with its exit code."""
    app()
