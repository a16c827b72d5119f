"""The group of commands that calibrate a camera."""

from __future__ import annotations

import typer

from stadimeter.cli import calibrate_board, calibrate_check, calibrate_distance

_calibrate_app = typer.Typer(
    name="calibrate",
    no_args_is_help=True,
    help="Find out a camera's focal length, write its camera file, and check it.",
)


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.add_typer(_calibrate_app)


@_calibrate_app.callback()
def _calibrate() -> None:
    """Find out a camera's focal length, write its camera file, and check it."""


calibrate_distance.register(_calibrate_app)
calibrate_board.register(_calibrate_app)
calibrate_check.register(_calibrate_app)
