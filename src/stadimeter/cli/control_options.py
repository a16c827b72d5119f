"""Options and output of the commands for a running instance."""

from __future__ import annotations

import getpass
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.control.client import ANSWER_WAIT_S, ask, find

ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", metavar="CONFIG", help="The configuration of the instance, if several run."),
]
SocketOption = Annotated[
    Path | None,
    typer.Option("--socket", metavar="PATH", help="The socket of the instance; by default it is found."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
ByOption = Annotated[
    str | None, typer.Option("--by", metavar="NAME", help="Who gives the command; by default the login name.")
]
WhyOption = Annotated[str, typer.Option("--why", metavar="TEXT", help="Why; it is recorded with the event.")]


def asked(
    op: str,
    args: Mapping[str, object],
    config: Path | None,
    socket: Path | None,
    wait_s: float = ANSWER_WAIT_S,
) -> Any:
    """Ask the running instance: that at a socket, or with a configuration, or the only one."""
    return ask(socket or find(config), op, args, wait_s)


def who(by: str | None) -> str:
    """Return who asks: as given, or the login name, below ``sudo`` that of the person."""
    if by is not None:
        return by
    try:
        return os.environ.get("SUDO_USER") or getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        return f"user {os.getuid()}"


def print_answer(data: Any, words: str, *, as_json: bool) -> None:
    """Print an answer."""
    typer.echo(json.dumps(data, ensure_ascii=False) if as_json else words)
