"""The command that prints the event log of the service."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.app.event_log import ENDING, log_files, parse_line
from stadimeter.app.places import SERVICE_STATE
from stadimeter.app.recordings.journal import MAGIC
from stadimeter.cli.exits import plain_errors
from stadimeter.config.files import open_untrusted
from stadimeter.errors import JournalError


def events(
    log: Annotated[Path | None, typer.Argument(metavar="LOG", help="The log; by default that of the service.")] = None,
    lines: Annotated[int, typer.Option("--lines", "-n", min=1, metavar="N", help="How many lines, the newest.")] = 50,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a line.")] = False,
) -> None:
    """Print what happened, and when: alarms, faults, orders.

    The service keeps this log for months, in five files of 1 MB at most. A question mark behind a time says that no
    time server vouched for the clock then. Events of rules are up to a minute old before they are in the log.

    With --json, each line is an object with time (ISO 8601; null where the line has none), is_synchronised (false for a
    question mark) and text.

    **Examples**

    - `sudo stadimeter events`

    - `sudo stadimeter events --lines 500`

    **Exit code**: 0 done; 2 there is no log, or it cannot be read.
    """
    with plain_errors():
        path = log or _of_service()
        _refuse_others(path)
        newest = [line for file in reversed(log_files(path)) for line in reversed(_read_lines(file))]
        if not newest:
            raise JournalError(f"{path}: there is no event log")
        for line in reversed(list(islice(newest, lines))):
            typer.echo(json.dumps(_record(line), ensure_ascii=False) if as_json else line)


def _refuse_others(path: Path) -> None:
    """Refuse a file that is no log; what `run --journal` or `--record` wrote is taken for one most often."""
    try:
        with open_untrusted(path) as file:
            head = file.read(len(MAGIC))
    except OSError:  # said where its lines are read
        return
    if head == MAGIC or head.startswith(b"{"):
        raise JournalError(
            f"{path} is a recording, not an event log: `stadimeter replay {path}` shows its events, and "
            f"`stadimeter explain RULE --journal {path}` why a rule acted"
        )
    if not head.isascii():  # a log begins with a time
        raise JournalError(f"{path} is no event log")


def _record(line: str) -> dict[str, object]:
    """Return a line of the log as the object that ``--json`` prints."""
    found = parse_line(line)
    if found is None:
        return {"time": None, "is_synchronised": False, "text": line}
    return dict(zip(("time", "is_synchronised", "text"), found, strict=True))


def _of_service() -> Path:
    """Return the log of the service, the one that was written last if it had several configurations."""
    try:
        found = sorted(SERVICE_STATE.glob(f"*{ENDING}"), key=lambda path: path.stat().st_mtime)
    except OSError as error:
        raise JournalError(f"{SERVICE_STATE}: {error.strerror}; try sudo") from error
    if not found:
        raise JournalError(f"there is no event log in {SERVICE_STATE}: only a service keeps one; or name the LOG")
    return found[-1]


def _read_lines(file: Path) -> list[str]:
    try:
        return file.read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:  # the service began a new file since this one was listed
        return []
    except OSError as error:
        raise JournalError(f"{file} cannot be read: {error.strerror}; try sudo") from error
