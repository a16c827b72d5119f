"""A command line that loads a command's module when the command is called, and not for the list of commands."""

from __future__ import annotations

import gc
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup


@dataclass(frozen=True, slots=True)
class LazyCommand:
    """A command that is not loaded yet.

    Attributes:
        module: A module with a function ``register``.
        summary: The first sentence of its help.
        panel: The heading in the list of commands that it stands under; empty for an old name, which is not listed.
    """

    module: str
    summary: str
    panel: str = ""


class LazyGroup(TyperGroup):
    """A group of commands from the table `LAZY`, which a subclass sets.

    Most of a start is imports, and no command needs what all the others import.
    """

    LAZY: ClassVar[Mapping[str, LazyCommand]] = {}

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        for name, lazy in self.LAZY.items():
            self.add_command(
                TyperCommand(
                    name,
                    help=lazy.summary,
                    hidden=not lazy.panel,
                    rich_help_panel=lazy.panel or None,
                    rich_markup_mode=self.rich_markup_mode,
                )
            )

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Load the command that is called, and let the group go on with it."""
        if args and args[0] in self.LAZY:
            self.load(args[0])
        return super().resolve_command(ctx, args)

    def load(self, name: str) -> Any:
        """Load a command of the table."""
        alone = typer.Typer(rich_markup_mode="markdown", pretty_exceptions_enable=False)
        lazy = self.LAZY[name]
        import_module(lazy.module).register(alone)
        command: Any = typer.main.get_group(alone).commands[name]
        command.hidden, command.rich_help_panel = not lazy.panel, lazy.panel or None
        self.add_command(command)
        if not gc.isenabled():  # `stadimeter.__main__` lets it rest while libraries are loaded, and those stay
            gc.freeze()
            gc.enable()
        return command
