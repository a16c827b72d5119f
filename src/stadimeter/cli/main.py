"""The command ``stadimeter``: one place that knows every command."""

from __future__ import annotations

import gc
import sys
from collections.abc import Mapping
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

import stadimeter
from stadimeter.cli.glyphs import write_plainly
from stadimeter.operator_actions import OperatorAction

ALARM_COMMANDS = tuple(action.command for action in OperatorAction if not action.is_on_outputs)

# The first sentence of the help of each command, by heading; below no heading are old names, which are not listed.
PANELS: Mapping[str, Mapping[str, str]] = {
    "Run": {
        "demo": "Watch a simulated ball being measured, followed and reported. Needs no hardware.",
        "init": "Write a first configuration: asks for camera, target and what shall happen, one thing at a time.",
        "run": "Measure, decide and act, until stopped.",
        "web": "Serve a page on which a browser sees, sets up and operates a run.",
        "bench": "Print how fast this computer measures and acts.",
        "doctor": "Find what keeps stadimeter from working on this computer, with one remedy for each.",
        "help": "Print the help of a command, or the list of commands.",
    },
    "Measure and calibrate": {
        "cameras": "List the cameras on this computer, each by the path that stays right.",
        "snapshot": "Take a picture with exactly the settings that `run` uses.",
        "measure": "Measure how far away a target is in pictures, in videos, or before a camera.",
        "colour": "Find out the range of colours of a ball, from a picture and a place in it.",
        "calibrate": "Find out a camera's focal length, write its camera file, and check it.",
        "print": "Make tags, boards, discs and sheets to print, at true scale.",
    },
    "Rules": {
        "check": "Check a configuration: print every error in one pass, or say in words what it does.",
        "wiring": "Draw what hangs on which pin of the Raspberry Pi, from a configuration.",
        "test": "Run the tests of a configuration. Nothing is opened and nothing moves.",
        "explain": "Explain why a rule acts, or why it does not.",
        "replay": "Run rules over a recording. Nothing is opened and nothing moves.",
        "tune": "Propose the probability, delays and hysteresis of an alarm, from recordings.",
        "schema": "Print a JSON Schema of configurations, for editors that complete and check while you write.",
    },
    "Operate a running instance": {
        "status": "Print the state of every rule of a running instance, and the reason.",
        "events": "Print what the rules and faults of the service did, and when.",
        "reload": "Apply the edited configuration of a running instance without a restart, if it passes `check`.",
        "stop-outputs": "Put every output of a running instance at its safe value, until they are released.",
        "alarm": "Acknowledge, reset or shelve an alarm of a running instance, and more.",
    },
    "": {name: f"`stadimeter alarm {name}`." for name in ALARM_COMMANDS},
}

_MODULES = {
    "print": "print_target",
    "snapshot": "cameras",
    "test": "test_rules",
    **dict.fromkeys(("status", "reload", "stop-outputs", "alarm", *ALARM_COMMANDS), "operate"),
}


def module_of(name: str) -> str:
    """Return the module with the function ``register`` that adds a command: by default it has the command's name."""
    return f"stadimeter.cli.{_MODULES.get(name, name)}"


class Commands(TyperGroup):
    """Every command, in the order of the help. Only the module of the command that is called is loaded.

    Most of a start is imports, and no command needs what all the others import.
    """

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self._panels = {name: panel for panel, commands in PANELS.items() for name in commands}
        for name, panel in self._panels.items():
            self._add(TyperCommand(name, help=PANELS[panel][name], rich_markup_mode=self.rich_markup_mode), panel)

    def _add(self, command: Any, panel: str) -> None:
        command.hidden, command.rich_help_panel = not panel, panel or None
        self.add_command(command)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Load the command that is called, and let the group go on with it."""
        if args and args[0] in self._panels:
            self.load(args[0])
        return super().resolve_command(ctx, args)

    def load(self, name: str) -> Any:
        """Load a command of the table."""
        alone = typer.Typer(rich_markup_mode="markdown", pretty_exceptions_enable=False)
        import_module(module_of(name)).register(alone)
        command: Any = typer.main.get_group(alone).commands[name]
        self._add(command, self._panels[name])
        if not gc.isenabled():  # `stadimeter.__main__` disables it while libraries are loaded, and those stay
            gc.freeze()
            gc.enable()
        return command


app = typer.Typer(
    name="stadimeter",
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
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

    Start with `stadimeter demo`, which needs no hardware. Then find out the `colour` of your ball, `calibrate` the
    camera with one picture at a known distance, `measure` some pictures, `check` a configuration and `run` it.
    """


def main() -> None:
    """Run the command line and leave the process with its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a file's name need be no text, nor need a terminal know every letter
            write_plainly(stream)
    app()
