"""Keeps the timeline of a run, as a listener of the loop: a row a second in memory, on the disk once a minute.

A memory card is written to as seldom as for the event log: what one kill or power cut costs is a minute.
"""

from __future__ import annotations

import math
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from msgspec import Struct

from stadimeter.app.control.recording import delete_old, recordings_folder
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.app.timeline.rows import LEVELS_S, STATES, Names, Rows, merge_rows, timeline_folder
from stadimeter.config.atomic_file import append_whole
from stadimeter.core.clock import DAY_S
from stadimeter.core.decide import State
from stadimeter.core.decision import RuleTrace
from stadimeter.core.frame import Frame
from stadimeter.core.track import Track

WRITE_EVERY_S = 60.0

# The seconds that wait for a disk that takes nothing, the newest.
WAITING_MAX = 3600

# A week of three targets and six rules takes 0.05 GB. This bound is for many targets, and for a clock that was wrong.
FOLDER_BYTES = 500_000_000

CLOSE_WAIT_S = 0.5

_RANKS = {state: rank for rank, state in enumerate(STATES)}


class _Second(Struct):
    """What is gathered of a second: of each target sums of distance and σ, extremes, and how often it was seen."""

    unix_s: int
    names: Names
    figures: list[list[float]]
    states: list[int]
    cycles: int = 0

    def add(self, tracks: Sequence[Track], rules: Sequence[RuleTrace]) -> None:
        self.cycles += 1
        self.states = [max(rank, _RANKS[trace.status]) for rank, trace in zip(self.states, rules, strict=False)]
        for figures, track in zip(self.figures, tracks, strict=False):
            if track.is_valid and track.distance_m is not None:
                figures[0] += track.distance_m
                figures[1] += track.sigma_m or 0.0
                figures[2] = min(figures[2], track.distance_m)
                figures[3] = max(figures[3], track.distance_m)
                figures[4] += 1

    def row(self) -> tuple[int, list[tuple[float, ...]], list[int]]:
        """Return it as a row has it; what was never seen has no figures."""
        return self.unix_s, [self._shown(*figures) for figures in self.figures], self.states

    def _shown(self, sum_m: float, sigmas_m: float, low_m: float, high_m: float, seen: float) -> tuple[float, ...]:
        if not seen:
            return math.nan, math.nan, math.nan, math.nan, 0.0
        return sum_m / seen, sigmas_m / seen, low_m, high_m, seen / self.cycles


class TimelineKeeper:
    """Keeps the timeline of a run; a `stadimeter.app.loop.RecordingSink`.

    Args:
        keep_s: What is older is deleted, a day at a time.
        unix_s: The computer's clock. Where it is set back, a new segment begins.
    """

    def __init__(self, folder: Path, keep_s: float, unix_s: Callable[[], float] = time.time) -> None:
        self._folder = folder
        self._keep_s = keep_s
        self._unix_s = unix_s
        self._second: _Second | None = None
        self._waiting: list[_Second] = []
        self._gathering = threading.Lock()  # never held while the disk is waited for
        self._disk = threading.Lock()
        self._ended = threading.Event()
        self._names: Names | None = None
        self._segment: Path | None = None
        self._begun: set[int] = set()
        self._fine: Rows = np.zeros(0)
        self._newest_s = 0
        self._trouble = ""

    def __call__(self, record: CycleRecord, _frame: Frame | None = None) -> None:
        """Take in a cycle."""
        decision, unix_s = record.decision, int(self._unix_s())
        if self._second is None or self._second.unix_s != unix_s:
            self._end_second()
            names = Names(
                tuple([track.target for track in decision.tracks]), tuple([trace.rule for trace in decision.rules])
            )
            figures = [[0.0, 0.0, math.inf, -math.inf, 0.0] for _ in decision.tracks]
            self._second = _Second(unix_s, names, figures, [0] * len(decision.rules))
        self._second.add(decision.tracks, decision.rules)

    def note_state(self, state: State) -> None:
        """Take in that the run goes on from an earlier one, which is no matter here."""

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:  # noqa: ARG002
        """Take in that from now on there may be other targets and rules."""
        self._end_second()

    def trouble(self) -> str:
        """Return why nothing is written at present; empty if all is well."""
        return self._trouble

    def start(self) -> None:
        """Begin to write, in a thread of its own."""
        threading.Thread(target=self._write_all, name="timeline", daemon=True).start()

    def write(self, *, is_end: bool = False) -> None:
        """Write the seconds that are over. What the disk does not take waits."""
        with self._gathering:
            seconds, self._waiting = self._waiting, []
        try:
            while seconds:
                count = self._fit(seconds)
                self._append(seconds[:count])
                del seconds[:count]
                self._append_coarse()
            self._append_coarse(is_end=is_end)
        except OSError as error:
            self._trouble = f"the timeline {self._folder} is not written: {error.strerror or error}"
            with self._gathering:
                self._waiting = (seconds + self._waiting)[-WAITING_MAX:]
        else:
            self._trouble = ""

    def close(self) -> None:
        """Write what waits, and end. Does not wait long for a disk that hangs."""
        self._ended.set()
        self._end_second()
        if self._disk.acquire(timeout=CLOSE_WAIT_S):
            try:
                self.write(is_end=True)
            finally:
                self._disk.release()

    def _end_second(self) -> None:
        if self._second is None:
            return
        with self._gathering:
            self._waiting.append(self._second)
            if len(self._waiting) > WAITING_MAX:
                del self._waiting[0]
                self._trouble = self._trouble or f"the timeline {self._folder}: the disk does not keep up"
        self._second = None

    def _write_all(self) -> None:
        while not self._ended.wait(WRITE_EVERY_S):
            with self._disk:
                self.write()

    def _fit(self, seconds: Sequence[_Second]) -> int:
        """Return how many of them go into one segment: the present one if it takes the first, else a new one."""
        names, day = seconds[0].names, seconds[0].unix_s // DAY_S
        is_same_day = self._newest_s == 0 or self._newest_s // DAY_S == day
        if self._segment is None or names != self._names or not is_same_day or seconds[0].unix_s <= self._newest_s:
            self._append_coarse(is_end=True)
            self._begin(names, seconds[0].unix_s)
        last_s = self._newest_s
        for count, each in enumerate(seconds):
            if each.names != names or each.unix_s // DAY_S != day or each.unix_s <= last_s:
                return count
            last_s = each.unix_s
        return len(seconds)

    def _begin(self, names: Names, unix_s: int) -> None:
        """Begin a segment of a name that no other has, and delete what is too old."""
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        delete_old(self._folder, self._keep_s, FOLDER_BYTES, "*.*")
        name = f"{datetime.fromtimestamp(unix_s, UTC):%Y%m%dT%H%M%SZ}-{uuid.uuid4().hex[:8]}"
        self._segment, self._names, self._newest_s = self._folder / name, names, 0
        self._fine, self._begun = np.zeros(0, names.row), set()

    def _append(self, seconds: Sequence[_Second]) -> None:
        rows: Rows = np.array([each.row() for each in seconds], self._fine.dtype)
        self._append_rows(1, rows)
        self._newest_s = seconds[-1].unix_s
        self._fine = np.concatenate([self._fine, rows])

    def _append_coarse(self, *, is_end: bool = False) -> None:
        """Write the coarser rows whose time is over, every ten minutes and at the end of a segment.

        If that fails, another segment begins: of this one the reader makes what is missing at the end of a level.
        """
        until_s = self._newest_s // LEVELS_S[-1] * LEVELS_S[-1]
        rows = self._fine if is_end or not len(self._fine) else self._fine[self._fine["unix_s"] < until_s]
        self._fine = self._fine[len(rows) :]
        try:
            for level_s in LEVELS_S[1:] if len(rows) else ():
                self._append_rows(level_s, merge_rows(rows, level_s))
        except OSError:
            self._segment, self._fine = None, np.zeros(0)
            raise

    def _append_rows(self, level_s: int, rows: Rows) -> None:
        """Append to a file, which begins with its names."""
        assert self._segment is not None  # noqa: S101 - a segment was begun for its first second
        assert self._names is not None  # noqa: S101
        head = b"" if level_s in self._begun else self._names.head
        path = self._segment.with_name(f"{self._segment.name}.{level_s}")
        append_whole(path, head + rows.tobytes(), is_lasting=False)
        self._begun.add(level_s)


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
    keeper.start()
    try:
        yield folder
    finally:
        keeper.close()
