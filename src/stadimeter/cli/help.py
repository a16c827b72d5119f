"""The command ``help``: the help of another command."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from stadimeter.cli.exits import WRONG


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command("help")(show_help)


def show_help(
    context: typer.Context,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="COMMAND…", help="A command, such as measure or calibrate distance.")
    ] = None,
) -> None:
    """Print the help of a command, or the list of commands.

    **Examples**

    - `stadimeter help`

    - `stadimeter help measure`

    - `stadimeter help calibrate distance`

    **Exit code**: 0 done; 2 there is no such command.
    """
    above: Any = context.parent
    for name in names or []:
        group = above.command
        _, command, _ = group.resolve_command(above, [name]) if hasattr(group, "commands") else (name, None, [])
        if command is None:
            typer.echo(f"error: there is no command '{' '.join(names or [])}'; `stadimeter help` lists them", err=True)
            raise typer.Exit(WRONG)
        above = type(above)(command, info_name=name, parent=above)
    typer.echo(above.get_help(), nl=False)
