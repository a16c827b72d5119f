"""The one place where a run leaves what there is to see of it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from stadimeter.app.clock import SteppedClock
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.live.health import Board
from stadimeter.app.live.history import RATE_WINDOW_S, WINDOW_S, RunHistory
from stadimeter.app.live.snapshot import Snapshot, Surroundings, snapshot_of
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame


@dataclass(slots=True)
class LiveFeed:
    """What there is to see of a run. The loop adds its cycles, which takes microseconds; any thread may look.

    Attributes:
        clock: The run's clock.
        unix_time_s: The computer's clock.
        real_time_s: The clock of `time.monotonic`.
        frame_at_s: When the loop was done with the newest frame, on that clock.
        cycle_at_s: When it was done with the newest cycle, on that clock; None before the first.
    """

    clock: Clock
    surroundings: Surroundings = field(default_factory=Surroundings)
    board: Board = field(default_factory=Board)
    unix_time_s: Callable[[], float] = time.time
    history: RunHistory = field(default_factory=RunHistory)
    real_time_s: Callable[[], float] = time.monotonic
    frame_at_s: float = 0.0
    cycle_at_s: float | None = None
    _passed: deque[tuple[float, float]] = field(default_factory=deque)

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle, in the loop's thread. Nobody is woken: that alone can cost a loop a millisecond."""
        self.history.add(record, frame)
        self.cycle_at_s = self.real_time_s()
        if frame is None:
            return
        self.frame_at_s = self.cycle_at_s
        self._passed.append((self.frame_at_s, record.observation.now_s))
        while self._passed[0][0] < self.frame_at_s - RATE_WINDOW_S:
            self._passed.popleft()

    def pace(self) -> float:
        """Return how fast a simulation or a recording passes of late, as a share of the speed that was asked for.

        1 for a live camera, and where it shall pass as fast as the computer can.
        """
        passed, speed = tuple(self._passed), self.clock.speed if isinstance(self.clock, SteppedClock) else None
        if not speed or len(passed) < 2 or passed[-1][0] <= passed[0][0]:
            return 1.0
        (from_real_s, from_s), (to_real_s, to_s) = passed[0], passed[-1]
        return (to_s - from_s) / (to_real_s - from_real_s) / speed

    def snapshot(self, window_s: float = WINDOW_S) -> Snapshot:
        """Return what there is to see now, with the distances of this long."""
        record = self.history.record
        after_s = record.observation.now_s - window_s if record is not None else 0.0
        return snapshot_of(self.history, self.surroundings, self.board, after_s, self.pace())

    def cycle_age_s(self) -> float:
        """Return how old the newest cycle is in real time: a loop that hangs, also on a stepped clock, grows old."""
        return self.real_time_s() - self.cycle_at_s if self.cycle_at_s is not None else 0.0

    def unix_offset_s(self) -> float:
        """Return what the computer's clock is ahead of the run's."""
        return self.unix_time_s() - self.clock.now_s()
