"""The event log: what rules and faults did, and when, in lines for people, for months; and the reader of its lines.

The system's own journal is in memory on Raspberry Pi OS. This log is on the disk, beside the state file, five files of
1 MB at most. A quiet hour writes nothing: lines are gathered and written once a minute. A fault, a warning of the run,
its beginning and its end are written within a second, and made to survive a power cut.

A question mark behind a time says that no time server vouched for the clock then. Once one does, a line says by how
much the clock was set.
"""

from __future__ import annotations

import math
import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct

from stadimeter.app.clock import local_now
from stadimeter.app.places import state_directory
from stadimeter.config.files import append_whole
from stadimeter.core.decision import Decision, Event, EventKind, SafetyMode, Severity

if TYPE_CHECKING:
    from stadimeter.app.cycle import CycleRecord
    from stadimeter.app.recordings.journal import RecordedConfiguration
    from stadimeter.core.decide import State
    from stadimeter.core.frame import Frame


FILE_BYTES_MAX = 1_000_000
FILES_MAX = 5
ENDING = ".log"

# Lines that must not wait are written at once, but no sooner than this after the last ones: a loose contact would else
# wear out a memory card.
LOOK_EVERY_S = 1.0
BATCH_EVERY_S = 60.0
URGENT_EVERY_S = 10.0

# Lines that a disk does not take are kept up to this many, the newest.
WAITING_MAX = 2000

CLOSE_WAIT_S = 0.5

# A camera that has given nothing for this long after the start is worth a line.
MISSING_AFTER_S = 10.0

# A clock that was set by more than this is worth a line.
SET_BY_S = 1.0

_ENDED = "ended: "
_LINE_BYTES_MAX = 4096

# What targets do is no event of a rule, and may happen many times a minute.
LEFT_OUT = frozenset({EventKind.TARGET_SEEN, EventKind.TARGET_LOST})

URGENT = frozenset(
    {
        EventKind.FAULT,
        EventKind.FAULT_CLEARED,
        EventKind.STOPPED,
        EventKind.RELEASED,
        EventKind.DISARMED,
        EventKind.ARMED,
    }
)


def event_log_path(configuration: Path, environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the event log of a configuration, in the ``$STATE_DIRECTORY`` of a service; None outside a service."""
    folder = state_directory(environ)
    return folder / f"{configuration.stem}{ENDING}" if folder is not None else None


def log_files(path: Path) -> list[Path]:
    """Return the files of a log that exist, oldest first."""
    names = [path, *(_numbered(path, number) for number in range(1, FILES_MAX))]
    return [name for name in reversed(names) if name.is_file()]


class KeptPast:
    """A part of a run's past. It gathers in memory, and a thread writes it: the loop never waits for the disk."""

    def __init__(self) -> None:
        self._trouble = ""
        self._ended = threading.Event()
        self._disk = threading.Lock()

    def note_state(self, state: State) -> None:
        """Take in that the run goes on from an earlier one; see `stadimeter.app.loop.RecordingSink`."""

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in that another configuration was loaded."""

    def trouble(self) -> str:
        """Return why nothing is written at present, in words; empty if all is well."""
        return self._trouble

    def begin(self, name: str) -> None:
        """Begin to write, in a thread of its own."""
        threading.Thread(target=self._write_all, name=name, daemon=True).start()

    def close(self) -> None:
        """Write what waits, and end. Does not wait long for a disk that hangs."""
        self._ended.set()
        if self._disk.acquire(timeout=CLOSE_WAIT_S):
            try:
                self.finish()
            finally:
                self._disk.release()

    def _write_all(self) -> None:
        while not self._ended.wait(LOOK_EVERY_S):
            with self._disk:
                self.step()

    def step(self) -> None:
        """Write what is due."""
        raise NotImplementedError

    def finish(self) -> None:
        """Write all that waits."""
        raise NotImplementedError


class EventLog(KeptPast):
    """Writes the log of one run.

    Args:
        is_right: Tells whether the computer's clock shows the right time.
    """

    def __init__(
        self,
        path: Path,
        *,
        now: Callable[[], datetime] = local_now,
        is_right: Callable[[], bool],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._path = path
        self._now = now
        self._is_right = is_right
        self._clock = clock
        self._lines: list[str] = []
        self._lost = 0
        self._is_urgent = False
        self._due_s = math.inf
        self._not_before_s = -math.inf
        self._was_right = is_right()
        self._ahead_s = self._wall_ahead_s()
        self._waits_since_s: float | None = clock()
        self._is_missing = False
        self._gathering = threading.RLock()  # a signal handler may have something to say

    def __call__(self, record: CycleRecord, _frame: Frame | None = None) -> None:
        """Take in the events of a cycle."""
        for event in record.decision.events:
            if event.kind not in LEFT_OUT:
                self._add(_in_words(event), is_urgent=event.kind in URGENT)
        if self._waits_since_s is not None and record.decision.safety not in {SafetyMode.STOPPED, SafetyMode.DISARMED}:
            self._wait_for_camera(record.decision, self._waits_since_s)

    def _wait_for_camera(self, decision: Decision, since_s: float) -> None:
        """Note a camera that gives nothing from the start on. That is no event: nothing was well before."""
        if decision.safety is not SafetyMode.STARTING:
            self._waits_since_s = None
            if self._is_missing:
                self.say("camera: the first frames have come")
        elif not self._is_missing and self._clock() - since_s > MISSING_AFTER_S:
            self._is_missing = True
            self.say(f"camera: {decision.safety_reason}")

    def end(self, words: str) -> None:
        """Say why the run ends, write what waits, and end. Does not wait long for a disk that hangs."""
        self.say(f"{_ENDED}{words}")
        self.close()

    def say(self, words: str) -> None:
        """Add a line about the run itself."""
        self._add(words, is_urgent=True)

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:  # noqa: ARG002
        """Take in that another configuration was loaded."""
        self.say("configuration reloaded")

    def start(self, words: str) -> None:
        """Begin to write, in a thread of its own; the first line says also if the last run did not end in order."""
        self.say(
            f"started: {words}" + ("; the run before it was killed, or had no power" if _is_cut(self._path) else "")
        )
        self.begin("event log")

    def step(self) -> None:
        """Write what is due."""
        if self._clock() >= max(self._due_s, self._not_before_s):
            self.finish()

    def _add(self, words: str, *, is_urgent: bool) -> None:
        is_right = self._is_right()
        with self._gathering:
            if is_right and not self._was_right:
                self._note_clock()
            self._was_right = is_right
            self._append(words, is_right=is_right)
            self._is_urgent |= is_urgent
            self._due_s = min(self._due_s, self._clock() + (0.0 if is_urgent else BATCH_EVERY_S))

    def _append(self, words: str, *, is_right: bool) -> None:
        time_of_day = self._now().isoformat(sep=" ", timespec="milliseconds")
        plain = "".join(each if each.isprintable() else " " for each in words)  # a terminal may show it
        self._lines.append(f"{time_of_day}{' ' if is_right else '?'} {' '.join(plain.split())}\n")
        self._forget_oldest()

    def _forget_oldest(self) -> None:
        self._lost += max(0, len(self._lines) - WAITING_MAX)
        del self._lines[:-WAITING_MAX]

    def _note_clock(self) -> None:
        before_s, self._ahead_s = self._ahead_s, self._wall_ahead_s()
        by_s = self._ahead_s - before_s
        if abs(by_s) > SET_BY_S:
            self._append(f"the clock was set by {by_s:+.0f} s: add that to the times with ?", is_right=True)

    def _wall_ahead_s(self) -> float:
        return self._now().timestamp() - self._clock()

    def finish(self) -> None:
        """Write every line that waits, or none."""
        with self._gathering:
            lines, self._lines = self._lines, []
            lost, self._lost = self._lost, 0
            is_urgent, self._is_urgent, self._due_s = self._is_urgent, False, math.inf
        if not lines:
            return
        first = [f"{lost} lines before this one are missing: {self._trouble}\n"] if lost else []
        try:
            _append_whole(self._path, "".join(first + lines).encode(errors="replace"), is_lasting=is_urgent)
        except OSError as error:
            self._trouble = f"the event log {self._path} is not written: {error.strerror or error}"
            with self._gathering:
                self._lines, self._lost = lines + self._lines, self._lost + lost
                self._forget_oldest()
                self._due_s = self._clock() + BATCH_EVERY_S
        else:
            self._trouble = ""
        self._not_before_s = self._clock() + URGENT_EVERY_S


def _append_whole(path: Path, data: bytes, *, is_lasting: bool) -> None:
    """Append to the log, or to a new file of it."""
    _rotate(path, len(data))
    append_whole(path, data, is_lasting=is_lasting)


def _rotate(path: Path, more_bytes: int) -> None:
    """Make room: ``NAME.log`` becomes ``NAME.log.1`` and so on; the oldest goes."""
    try:
        if path.stat().st_size + more_bytes <= FILE_BYTES_MAX:
            return
    except FileNotFoundError:
        return
    for number in range(FILES_MAX - 1, 0, -1):
        with suppress(FileNotFoundError):
            _numbered(path, number - 1).replace(_numbered(path, number))


def _is_cut(path: Path) -> bool:
    """Check whether the last line of a log is no end of a run."""
    if not path.is_file():  # a pipe would be waited for
        return False
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - _LINE_BYTES_MAX))
            lines = file.read().splitlines()
    except OSError:
        return False
    return bool(lines) and _ENDED.encode() not in lines[-1]


def _numbered(path: Path, number: int) -> Path:
    return path.with_name(f"{path.name}.{number}") if number else path


def _in_words(event: Event) -> str:
    who = f" by {event.by}" if event.by else ""
    reason = f": {event.reason}" if event.reason else ""
    return f"{event.severity.value}: {event.source} {event.kind.value.replace('_', ' ')}{who}{reason}"


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
