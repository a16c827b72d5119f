"""The command ``stadimeter``: one place that knows every command."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Mapping
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

import stadimeter
from stadimeter.cli.exits import SWITCH, WRONG, end_without_space, working

# Loading the libraries of a command is announced where it takes longer than on any computer but a small or busy one.
SLOW_START_S = 1.0

# The first sentence of the help of each command, by heading. Those of the first heading are shown first.
PANELS: Mapping[str, Mapping[str, str]] = {
    "Start here": {
        "demo": "Watch a simulated ball being measured and followed. No hardware.",
        "init": "Write your first configuration, one question at a time.",
        "run": "Measure, decide and act, until stopped.",
        "measure": "Measure how far away a target is: in pictures, or before a camera.",
        "calibrate": "Find a camera's focal length, or how large a target is.",
        "check": "Name every mistake in a configuration, or say what it does.",
        "explain": "Explain why a rule acts, or why it does not.",
        "doctor": "Find what keeps stadimeter from working here, with remedies.",
    },
    "Measure and calibrate": {
        "cameras": "List the cameras on this computer, each by a path that survives reboots.",
        "snapshot": "Take a picture with the settings that `run` uses.",
        "colour": "Find the range of a ball's colours, from a picture and a place in it.",
        "site": "Check how right distances are at this place, and whether the camera has moved.",
        "print": "Make tags, boards and discs to print, at true scale.",
    },
    "Rules": {
        "drive": "Turn each wheel of a robot a little, to see which motor drives it, and which way.",
        "wiring": "Draw which part is on which pin of the Raspberry Pi.",
        "test": "Run the tests of a configuration. Nothing is opened and nothing moves.",
        "replay": "Run rules over a recording. Nothing is opened and nothing moves.",
        "tune": "Find an alarm's threshold, delays and deadband from recordings.",
    },
    "Operate a running instance": {
        "stop": "Put every output at its safe value, until `stadimeter outputs release`.",
        "outputs": "Stop, release, arm or disarm outputs, or make them safe where no instance runs.",
        "status": "Print the state of every rule, and the reason.",
        "events": "Print what happened, and when: alarms, faults, orders.",
        "alarm": "Acknowledge, reset or shelve an alarm.",
        "reload": "Apply the edited configuration without a restart, if it passes `check`.",
        "record": "Record with pictures: from now on, or a clip of the seconds around now.",
        "web": "Serve a page for your browser: see, set up and operate a run.",
        "fleet": "Show every device at a broker, and one list of standing alarms.",
    },
    "Help": {"help": "Print the help of a command, or with --all the list of every command."},
}

SHORT_HELP = "\n".join(
    [
        "Turn a camera into a rangefinder that acts. Usage: stadimeter COMMAND [OPTIONS]",
        "",
        *(f"  {name:9}  {summary}" for name, summary in PANELS["Start here"].items()),
        "",
        "New here?              stadimeter demo, then stadimeter init",
        "Every command:         stadimeter help --all",
        "About one command:     stadimeter help measure",
        "Stop what moves:       stadimeter stop",
        "In your browser:       stadimeter web",
        "Version:               stadimeter --version",
        "Complete commands:     stadimeter --install-completion",
    ]
)

# The module and the function (or group) of a command, where it has not the command's name twice.
_PLACES = {
    "help": "main:show_help",
    "snapshot": "cameras:snapshot",
    "print": "print_target:print_group",
    "test": "test_rules:run_tests",
    "wiring": "print_target:wiring",
    "explain": "explain:explain_command",
    "tune": "tune:tune_command",
    "status": "operate:status",
    "events": "events:events",
    "reload": "operate:reload",
    "alarm": "operate:alarm",
    "outputs": "operate:outputs",
    "stop": "operate:stop",
    "record": "operate:record",
}


def place_of(name: str) -> tuple[str, str]:
    """Return the module of a command, and the function or group in it."""
    module, function = _PLACES.get(name, f"{name}:{name}").split(":")
    return f"stadimeter.cli.{module}", function


# What stops something goes on under its old name: no script shall fail at that.
STILL = {"stop-outputs": ("outputs", "stop"), "disarm": ("outputs", "disarm"), "safe": ("outputs", "safe")}


class Commands(TyperGroup):
    """Every command, in the order of the help. Only the module of the command that is called is loaded.

    Most of a start is imports, and no command needs what all the others import.
    """

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self.shows_all = False
        self._panels = {name: panel for panel, commands in PANELS.items() for name in commands}
        for name, panel in self._panels.items():
            self._add(TyperCommand(name, help=PANELS[panel][name], rich_markup_mode=self.rich_markup_mode), panel)

    def _add(self, command: Any, panel: str) -> None:
        command.rich_help_panel = panel
        self.add_command(command)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the commands for the first hour, on one screen; with ``--all`` every command, as the others are."""
        if self.shows_all:
            super().format_help(ctx, formatter)
        else:
            typer.echo(SHORT_HELP)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Load the command that is called, and let the group go on with it."""
        called = args[0] if args else ""
        if called in STILL:
            typer.echo(f"note: say `stadimeter {' '.join(STILL[called])}` in place of `{called}`", err=True)
            args = [*STILL[called], *args[1:]]
        if args and args[0] in self._panels:
            self.load(args[0])
        return super().resolve_command(ctx, args)

    def load(self, name: str) -> Any:
        """Load a command of the table."""
        module, function = place_of(name)
        with working("starting", SLOW_START_S):
            found = getattr(import_module(module), function)
        gc.freeze()  # or the collector walks through every library once more when the process ends: 50 ms
        alone = typer.Typer(rich_markup_mode="markdown", pretty_exceptions_enable=False)
        if isinstance(found, typer.Typer):
            alone.add_typer(found, name=name)
        else:
            alone.command(name)(found)
        command: Any = typer.main.get_group(alone).commands[name]
        self._add(command, self._panels[name])
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
    """


def show_help(
    context: typer.Context,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="COMMAND…", help="A command, such as measure or calibrate distance.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="List every command, by what it is for.")] = False,
) -> None:
    """Print the help of a command, or with --all the list of every command.

    **Examples**

    - `stadimeter help --all`

    - `stadimeter help measure`

    - `stadimeter help calibrate distance`

    **Exit code**: 0 done; 2 there is no such command.
    """
    above: Any = context.parent
    above.command.shows_all = every
    for name in names or []:
        group = above.command
        _, command, _ = group.resolve_command(above, [name]) if hasattr(group, "commands") else (name, None, [])
        if command is None:
            typer.echo(f"error: there is no command '{' '.join(names or [])}'; `stadimeter help` lists them", err=True)
            raise typer.Exit(WRONG)
        above = type(above)(command, info_name=name, parent=above)
    typer.echo(above.get_help(), nl=False)


def main() -> None:
    """Run the command line and leave the process with its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a file's name need be no text, nor need a terminal know every letter
            stream.reconfigure(errors="backslashreplace")
    if isinstance(sys.stdin, TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")  # what is typed need not be text either
    if "_STADIMETER_COMPLETE" in os.environ:
        os.environ[SWITCH] = "off"  # what is completed stands on the prompt's line, where no progress belongs
    try:
        app()
    except OSError as error:
        end_without_space(error)
