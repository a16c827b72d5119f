"""Reads the event log: its lines, and the events in them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from msgspec import Struct

from stadimeter.app.event_log import log_files
from stadimeter.core.decision import EventKind, Severity

# The lines of a day that a clock was set back stand behind those of the next.
CLOCK_SET_S = 86400.0

_LINE = re.compile(r"(?P<time>\d{4}-\d\d-\d\d [\d:.]+[+-]\d\d:\d\d)(?P<mark>[ ?]) (?P<text>.*)")
_KINDS = "|".join(sorted((kind.value.replace("_", " ") for kind in EventKind), key=len, reverse=True))
_EVENT = re.compile(
    rf"(?P<severity>{'|'.join(Severity)}): (?P<source>\S+) (?P<kind>{_KINDS})(?: by (?P<by>.*?))?(?:: (?P<reason>.*))?"
)


class LoggedEvent(Struct, frozen=True, kw_only=True):
    """A line of the log.

    Attributes:
        kind: An `EventKind`; empty for what the run says of itself, which is in `reason`.
        is_synchronised: Whether a time server vouched for the clock then.
    """

    unix_s: float
    is_synchronised: bool
    kind: str = ""
    source: str = ""
    severity: str = ""
    by: str = ""
    reason: str = ""


def parse_line(line: str) -> tuple[str, bool, str] | None:
    """Return the time of a line, whether it was right, and its text; None for a line of another form."""
    found = _LINE.fullmatch(line)
    return (found["time"].replace(" ", "T"), found["mark"] == " ", found["text"]) if found else None


def read_events(path: Path, from_s: float, to_s: float) -> Iterator[LoggedEvent]:
    """Yield what a log has of a time, newest first; of a clock that was set, lines may be out of order."""
    for file in reversed(log_files(path)):
        with suppress(OSError):  # begun anew since it was listed
            for line in reversed(file.read_text(encoding="utf-8", errors="replace").splitlines()):
                event = _logged(line)
                if event is not None and event.unix_s < from_s - CLOCK_SET_S:
                    return
                if event is not None and from_s <= event.unix_s < to_s:
                    yield event


def _logged(line: str) -> LoggedEvent | None:
    parsed = parse_line(line)
    if parsed is None:
        return None
    unix_s = datetime.fromisoformat(parsed[0]).timestamp()
    found = _EVENT.fullmatch(parsed[2])
    if found is None:
        return LoggedEvent(unix_s=unix_s, is_synchronised=parsed[1], reason=parsed[2])
    words = {name: found[name] or "" for name in ("source", "severity", "by", "reason")}
    kind = found["kind"].replace(" ", "_")
    return LoggedEvent(unix_s=unix_s, is_synchronised=parsed[1], kind=kind, **words)
