"""The command ``explain``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.control.messages import as_data
from stadimeter.cli.control_options import JsonOption, SocketOption, asked, tell
from stadimeter.cli.exits import told_plainly
from stadimeter.workbench.replay.explaining import explain_recording, seconds_ago
from stadimeter.workbench.replay.opening import read_recording
from stadimeter.workbench.replay.replay_run import replay_run


def register(app: typer.Typer) -> None:
    """Add the command.

    Args:
        app: The command line.
    """
    app.command("explain")(explain_command)


def explain_command(
    rule: Annotated[str, typer.Argument(metavar="RULE", help="The rule.")],
    at: Annotated[
        str | None,
        typer.Option(
            "--at",
            metavar="TIME",
            help='When: a time of day, "14:03:20"; or "12.5 s": after the beginning of the recording, or ago.',
        ),
    ] = None,
    journal: Annotated[
        Path | None,
        typer.Option("--journal", metavar="FILE", help="A journal or recording; without it, the running instance."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", metavar="CONFIG", help="With --journal: other rules than the recording's; else: which instance."
        ),
    ] = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say why a rule does what it does, and why it does not do more.

    Asks the running instance about this moment, or about one of the last minute. With --journal, asks a recording
    about any moment of it: everything up to there is decided again, and nothing is opened or moved.

    **Examples**

    - `stadimeter explain near`

    - `stadimeter explain near --journal run.jsonl --at "14.2 s"`

    **Exit code**: 0 done; 2 there is no such rule, recording, moment or running instance.
    """
    with told_plainly():
        if journal is None:
            told = asked("explain", {"rule": rule, **_moment(at)}, config, socket)
            tell(told, "\n".join(_told(each) for each in told["rules"]), as_json=as_json)
            return
        run = replay_run(read_recording(journal), config)
        explanation, since_s = explain_recording(run, rule, at)
    if as_json:
        typer.echo(json.dumps({**as_data(explanation), "since_beginning_s": round(since_s, 6)}, ensure_ascii=False))
    else:
        typer.echo(f"At {since_s:.2f} s: {_told(as_data(explanation))}")


def _moment(at: str | None) -> dict[str, float]:
    """Return the moment that the running instance is asked about, on the wall clock."""
    if at is None:
        return {}
    now = datetime.now().astimezone()
    return {"at_unix_s": now.timestamp() - seconds_ago(at, now)}


def _told(explanation: Mapping[str, Any]) -> str:
    lines = [f"{explanation['rule']}: {explanation['sentence']}"]
    if len(explanation["evidence"]) > 1:
        lines += [f"  {_MARKS[each['holds']]} {each['words']}" for each in explanation["evidence"]]
    return "\n".join(lines)


_MARKS = {True: "yes    ", False: "no     ", None: "unknown"}
