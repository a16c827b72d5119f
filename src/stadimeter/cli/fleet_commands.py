"""The commands of a fleet as one group, whose first is meant where none is named."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

from stadimeter.cli.fleet import fleet as show
from stadimeter.cli.fleet_apply import apply
from stadimeter.cli.fleet_receive import arm, receive


class FleetCommands(TyperGroup):
    """The commands of a fleet. What is none of them is for `show`, as in ``stadimeter fleet CONFIG --check``."""

    default = "show"

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put ``show`` before what does not begin with a command."""
        is_command = bool(args) and args[0] in {*self.commands, *ctx.help_option_names}
        return super().parse_args(ctx, args if is_command else [self.default, *args])


fleet = typer.Typer(cls=FleetCommands, rich_markup_mode="markdown")


@fleet.callback()
def _fleet() -> None:
    """Show every device at a broker, and one list of standing alarms.

    And give devices a configuration. `stadimeter fleet CONFIG` is `stadimeter fleet show CONFIG`.
    """


for _command in (show, apply, receive, arm):
    fleet.command("show" if _command is show else _command.__name__)(_command)
