"""The timeline of a run: what each second was like, kept for days, in rows of fixed length in files that only grow.

A segment is what one run wrote of the same targets and rules, for a day at most: a file with a row for each second, in
which a time is found by halving; a long time is merged when it is read. Each row has the time by the computer's clock
and by that of the run: recordings go by that, and either may lag or be set. Each file begins with a line of JSON that
names targets and rules. Half a row at the end, as after a power cut, is not read.

The loop hands cycles over; all else is done in a thread. A memory card is written to as seldom as for the event log:
what a kill or a power cut costs is a minute.
"""

from __future__ import annotations

import math
import os
import time
import uuid
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.app.control.recording import recordings_folder
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.event_log import ENDING, KeptPast
from stadimeter.app.recordings.journal import delete_old
from stadimeter.config.files import JSON_MAX_BYTES, append_whole, open_untrusted
from stadimeter.core.clock import DAY_S
from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Track
from stadimeter.errors import JournalError, StadimeterError

FOLDER = "timeline"
SECONDS = ".1"

# What rows consist of; files of another format are passed over.
FORMAT = 2

# What is known of a target in a row: means, the extremes of the distance, and how much of the time it was seen.
FIGURES = ("mean_m", "sigma_m", "low_m", "high_m", "seen")
MEAN, SIGMA, LOW, HIGH, SEEN = range(5)

# What a rule did in a row: of several states the one that stands last here, so that a short alarm is seen from afar.
# The first is for no state at all.
STATES = (
    "",
    RuleStatus.IDLE,
    RuleStatus.UNKNOWN,
    RuleStatus.PENDING,
    RuleStatus.RETURNED,
    RuleStatus.CLEARING,
    RuleStatus.LATCHED,
    RuleStatus.ACTIVE,
)

Rows = NDArray[Any]


class Names(Struct, frozen=True):
    """The targets and the rules of a segment, in the order of its rows."""

    targets: tuple[str, ...]
    rules: tuple[str, ...]
    format: int = FORMAT

    @property
    def row(self) -> np.dtype[Any]:
        """The parts of a row."""
        figures = ("figures", "<f4", (len(self.targets), len(FIGURES)))
        return np.dtype([("unix_s", "<u4"), ("run_s", "<f8"), figures, ("states", "u1", (len(self.rules),))])

    @property
    def head(self) -> bytes:
        """The line with which a file begins."""
        return msgspec.json.encode(self) + b"\n"


def timeline_folder(recordings: Path, configuration: Path) -> Path:
    """Return where the timeline of a configuration is: beside the folder of its recordings."""
    return recordings.parent / FOLDER / configuration.stem


def event_log_beside(folder: Path) -> Path:
    """Return the event log of a run that is no service, which is kept with its timeline."""
    return folder / f"events{ENDING}"


def merge_rows(rows: Rows, step_s: int) -> Rows:
    """Return one row for each step of time that has any; extremes and short states stay."""
    if not len(rows):
        return rows
    steps = rows["unix_s"] // step_s
    begins = np.flatnonzero(np.concatenate([[True], steps[1:] != steps[:-1]]))
    merged = np.zeros(len(begins), rows.dtype)
    merged["unix_s"] = steps[begins] * step_s
    merged["run_s"] = rows["run_s"][begins]
    merged["states"] = np.maximum.reduceat(rows["states"], begins)
    found, figures = rows["figures"], merged["figures"]
    seen = np.add.reduceat(found[..., SEEN], begins)
    with np.errstate(invalid="ignore"):  # 0 / 0: never seen, so there is no mean
        for mean in (MEAN, SIGMA):
            figures[..., mean] = np.add.reduceat(np.nan_to_num(found[..., mean]) * found[..., SEEN], begins) / seen
    figures[..., LOW] = np.fmin.reduceat(found[..., LOW], begins)
    figures[..., HIGH] = np.fmax.reduceat(found[..., HIGH], begins)
    figures[..., SEEN] = seen / np.diff(begins, append=len(rows))[:, None]
    return merged


def read_rows(folder: Path, from_s: float, to_s: float, step_s: int) -> Iterator[tuple[Names, Rows]]:
    """Yield the rows of each segment between two times, oldest first, merged to steps of at least a second.

    A file that is no timeline, or gone by now, is passed over.
    """
    for path in sorted(folder.glob(f"*{SECONDS}")):
        try:
            names, rows = _read_segment(path, from_s, to_s)
        except (StadimeterError, OSError, ValueError):
            continue
        if len(rows):
            yield names, merge_rows(rows, step_s)


def _read_segment(path: Path, from_s: float, to_s: float) -> tuple[Names, Rows]:
    """Return the rows of a file from one time up to another, which is found by halving."""
    with open_untrusted(path) as file:
        names = msgspec.json.decode(file.readline(JSON_MAX_BYTES), type=Names)
        if names.format != FORMAT:
            raise JournalError(f"{path} is a timeline of another format")
        row, begin = names.row, file.tell()
        count = (os.fstat(file.fileno()).st_size - begin) // row.itemsize

        def time_of(number: int) -> int:
            return _time_at(file, begin + number * row.itemsize)

        while count and not time_of(count - 1):  # a power cut may leave zeros at the end
            count -= 1
        first, end = (bisect_left(range(count), at_s, key=time_of) for at_s in (from_s, to_s))
        file.seek(begin + first * row.itemsize)
        return names, np.frombuffer(file.read((end - first) * row.itemsize), row)


def _time_at(file: BinaryIO, byte: int) -> int:
    return int.from_bytes(os.pread(file.fileno(), 4, byte), "little")


WRITE_EVERY_S = 60.0

# The cycles that wait for the thread while a disk hangs, the newest; and the seconds that wait for one that is full.
CYCLES_MAX = 4096
SECONDS_MAX = 3600

# A week of three targets and six rules takes 0.05 GB. This bound is for many targets, and for a clock that was wrong.
FOLDER_BYTES = 500_000_000

_RANKS = {state: rank for rank, state in enumerate(STATES)}

# When it was by the computer's clock and by the run's, what was tracked, and what the rules did.
_Cycle = tuple[int, float, Sequence[Track], Sequence[RuleTrace]]


class TimelineKeeper(KeptPast):
    """Keeps the timeline of a run; a `stadimeter.app.loop.RecordingSink`.

    Args:
        keep_s: What is older is deleted, a day at a time.
        unix_s: The computer's clock. Where it is set back, a new segment begins.
    """

    def __init__(self, folder: Path, keep_s: float, unix_s: Callable[[], float] = time.time) -> None:
        super().__init__()
        self._folder = folder
        self._keep_s = keep_s
        self._unix_s = unix_s
        self._cycles: deque[_Cycle] = deque(maxlen=CYCLES_MAX)
        self._names = Names((), ())
        self._segment: Path | None = None
        self._is_begun = False
        self._rows: Rows = np.zeros(0, self._names.row)  # of the segment: what is not written yet
        self._last_s = 0
        self._due_s = 0.0

    def __call__(self, record: CycleRecord, _frame: Frame | None = None) -> None:
        """Take in a cycle."""
        decision = record.decision
        self._cycles.append((int(self._unix_s()), record.observation.now_s, decision.tracks, decision.rules))

    def step(self, *, is_end: bool = False) -> None:
        """Make rows of the seconds that are over, and write what is due."""
        while self._cycles and (is_end or self._cycles[0][0] != self._cycles[-1][0]):
            second = [self._cycles.popleft()]
            unix_s, names = second[0][0], _names_of(second[0])
            while self._cycles and self._cycles[0][0] == unix_s and _names_of(self._cycles[0]) == names:
                second.append(self._cycles.popleft())
            self._add(names, unix_s, np.array([_row_of(cycle) for cycle in second], names.row))
            if not self._due_s - WRITE_EVERY_S <= unix_s < self._due_s:
                self._write()
                self._due_s = unix_s + WRITE_EVERY_S

    def finish(self) -> None:
        """Make rows of the last second, too, and write all."""
        self.step(is_end=True)
        self._write()

    def _add(self, names: Names, unix_s: int, cycles: Rows) -> None:
        is_next = self._last_s < unix_s and self._last_s // DAY_S == unix_s // DAY_S
        if self._segment is None or names != self._names or not is_next:
            self._write()
            name = f"{datetime.fromtimestamp(unix_s, UTC):%Y%m%dT%H%M%SZ}-{uuid.uuid4().hex[:8]}"
            self._segment, self._names = self._folder / f"{name}{SECONDS}", names
            self._rows, self._is_begun = np.zeros(0, names.row), False
        self._rows = np.concatenate([self._rows, merge_rows(cycles, 1)])[-SECONDS_MAX:]
        self._last_s = unix_s

    def _write(self) -> None:
        """Append to the file of the segment, which begins with the names; before that, what is too old goes."""
        if self._segment is None or not len(self._rows):
            return
        try:
            head = b""
            if not self._is_begun:
                self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                delete_old(self._folder, self._keep_s, FOLDER_BYTES, "*.*")
                head = self._names.head
            append_whole(self._segment, head + self._rows.tobytes(), is_lasting=False)
            self._rows, self._is_begun, self._trouble = self._rows[:0], True, ""
        except OSError as error:
            self._trouble = f"the timeline {self._folder} is not written: {error.strerror or error}"


def _names_of(cycle: _Cycle) -> Names:
    _, _, tracks, rules = cycle
    return Names(tuple([track.target for track in tracks]), tuple([trace.rule for trace in rules]))


def _row_of(cycle: _Cycle) -> tuple[int, float, list[tuple[float, ...]], list[int]]:
    unix_s, run_s, tracks, rules = cycle
    return unix_s, run_s, [_figures_of(track) for track in tracks], [_RANKS[trace.status] for trace in rules]


def _figures_of(track: Track) -> tuple[float, ...]:
    if not track.is_valid or track.distance_m is None:
        return math.nan, math.nan, math.nan, math.nan, 0.0
    return track.distance_m, track.sigma_m or 0.0, track.distance_m, track.distance_m, 1.0


@contextmanager
def keep_timeline(
    listeners: list[Callable[[CycleRecord, Frame | None], None]], configuration: Path, keep_s: float
) -> Iterator[Path]:
    """Keep the timeline of a run while in the context; give its folder, which is there unless the disk takes none."""
    folder = timeline_folder(recordings_folder(configuration), configuration)
    with suppress(OSError):  # the first write says so
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    keeper = TimelineKeeper(folder, keep_s)
    listeners.append(keeper)
    keeper.begin("timeline")
    try:
        yield folder
    finally:
        keeper.close()
