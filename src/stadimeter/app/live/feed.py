"""The one place where a run leaves what there is to see of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.live.health import Board
from stadimeter.app.live.history import WINDOW_S, RunHistory
from stadimeter.app.live.snapshot import Snapshot, Surroundings, snapshot_of
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame


@dataclass(slots=True)
class LiveFeed:
    """What there is to see of a run. The loop adds its cycles, which takes microseconds; any thread may look.

    Attributes:
        clock: The run's clock.
        unix_time_s: The computer's clock.
        frame_at_s: When the loop was done with the newest frame, on the clock of `time.monotonic`.
    """

    clock: Clock
    surroundings: Surroundings = field(default_factory=Surroundings)
    board: Board = field(default_factory=Board)
    unix_time_s: Callable[[], float] = time.time
    history: RunHistory = field(default_factory=RunHistory)
    frame_at_s: float = 0.0

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle, in the loop's thread. Nobody is woken: that alone can cost a loop a millisecond."""
        self.history.add(record, frame)
        if frame is not None:
            self.frame_at_s = time.monotonic()

    def snapshot(self, window_s: float = WINDOW_S) -> Snapshot:
        """Return what there is to see now, with the distances of this long."""
        record = self.history.record
        after_s = record.observation.now_s - window_s if record is not None else 0.0
        return snapshot_of(self.history, self.surroundings, self.board, after_s)

    def unix_offset_s(self) -> float:
        """Return what the computer's clock is ahead of the run's."""
        return self.unix_time_s() - self.clock.now_s()
