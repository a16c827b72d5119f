"""The command ``stadimeter``: one place that knows every command."""

from __future__ import annotations

import gc
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

import stadimeter
from stadimeter.cli.glyphs import write_plainly


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


ALARM_COMMANDS = ("ack", "reset", "shelve", "unshelve", "take-out", "put-back")
RUN, MEASURE, RULES, OPERATE = "Run", "Measure and calibrate", "Rules", "Operate a running instance"


class Commands(LazyGroup):
    """Every command, in the order of the help."""

    LAZY: ClassVar[Mapping[str, LazyCommand]] = {
        "demo": LazyCommand(
            "stadimeter.cli.demo",
            "Watch a simulated ball being measured, followed and reported. Needs no hardware.",
            RUN,
        ),
        "init": LazyCommand(
            "stadimeter.cli.init",
            "Write a first configuration: asks for camera, target and what shall happen, one thing at a time.",
            RUN,
        ),
        "run": LazyCommand("stadimeter.cli.run", "Measure, decide and act, until stopped.", RUN),
        "web": LazyCommand(
            "stadimeter.cli.web", "Serve a page on which a browser sees, sets up and operates a run.", RUN
        ),
        "bench": LazyCommand("stadimeter.cli.bench", "Print how fast this computer measures and acts.", RUN),
        "doctor": LazyCommand(
            "stadimeter.cli.doctor",
            "Find what keeps stadimeter from working on this computer, with one remedy for each.",
            RUN,
        ),
        "help": LazyCommand("stadimeter.cli.help", "Print the help of a command, or the list of commands.", RUN),
        "cameras": LazyCommand(
            "stadimeter.cli.cameras",
            "List the cameras on this computer, each by the path that stays right.",
            MEASURE,
        ),
        "snapshot": LazyCommand(
            "stadimeter.cli.snapshot", "Take a picture with exactly the settings that `run` uses.", MEASURE
        ),
        "measure": LazyCommand(
            "stadimeter.cli.measure",
            "Measure how far away a target is in pictures, in videos, or before a camera.",
            MEASURE,
        ),
        "colour": LazyCommand(
            "stadimeter.cli.colour",
            "Find out the range of colours of a ball, from a picture and a place in it.",
            MEASURE,
        ),
        "calibrate": LazyCommand(
            "stadimeter.cli.calibrate",
            "Find out a camera's focal length, write its camera file, and check it.",
            MEASURE,
        ),
        "print": LazyCommand(
            "stadimeter.cli.print_target", "Make tags, boards, discs and sheets to print, at true scale.", MEASURE
        ),
        "check": LazyCommand(
            "stadimeter.cli.check",
            "Check a configuration: print every error in one pass, or say in words what it does.",
            RULES,
        ),
        "wiring": LazyCommand(
            "stadimeter.cli.wiring", "Draw what hangs on which pin of the Raspberry Pi, from a configuration.", RULES
        ),
        "test": LazyCommand(
            "stadimeter.cli.test_rules", "Run the tests of a configuration. Nothing is opened and nothing moves.", RULES
        ),
        "explain": LazyCommand("stadimeter.cli.explain", "Explain why a rule acts, or why it does not.", RULES),
        "replay": LazyCommand(
            "stadimeter.cli.replay", "Run rules over a recording. Nothing is opened and nothing moves.", RULES
        ),
        "tune": LazyCommand(
            "stadimeter.cli.tune", "Propose the probability, delays and hysteresis of an alarm, from recordings.", RULES
        ),
        "schema": LazyCommand(
            "stadimeter.cli.schema",
            "Print a JSON Schema of configurations, for editors that complete and check while you write.",
            RULES,
        ),
        "status": LazyCommand(
            "stadimeter.cli.operate", "Print the state of every rule of a running instance, and the reason.", OPERATE
        ),
        "events": LazyCommand(
            "stadimeter.cli.events", "Print what the rules and faults of the service did, and when.", OPERATE
        ),
        "reload": LazyCommand(
            "stadimeter.cli.operate",
            "Apply the edited configuration of a running instance without a restart, if it passes `check`.",
            OPERATE,
        ),
        "stop-outputs": LazyCommand(
            "stadimeter.cli.operate",
            "Put every output of a running instance at its safe value, until they are released.",
            OPERATE,
        ),
        "alarm": LazyCommand(
            "stadimeter.cli.operate", "Acknowledge, reset or shelve an alarm of a running instance, and more.", OPERATE
        ),
        # Names of earlier versions.
        **{name: LazyCommand("stadimeter.cli.operate", f"`stadimeter alarm {name}`.") for name in ALARM_COMMANDS},
    }


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
