"""Figures on a run: how many frames, how often the target was tracked, how old the data was that was acted on."""

from __future__ import annotations

import os
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from stadimeter.app.cycle import CycleRecord

# Percentiles are over this many of the newest cycles: a run of weeks needs no more memory than one of minutes.
LATEST = 10_000


def _latest() -> deque[float]:
    return deque(maxlen=LATEST)


@dataclass(slots=True)
class Health:
    """Counts and times of a run.

    Attributes:
        frames: Cycles with a new frame.
        track_statuses: For each target, how many frames it spent in each status.
        events: How many events of each kind.
        data_ages_s: For the newest cycles, the age of the frame when its commands had been applied.
        cycle_times_s: For the newest cycles, the computing time without waiting for the frame.
        first_command_s: How old the program was when the commands of its first frame had been applied; None before.
    """

    cycles: int = 0
    frames: int = 0
    track_statuses: dict[str, Counter[str]] = field(default_factory=dict)
    events: Counter[str] = field(default_factory=Counter)
    data_ages_s: deque[float] = field(default_factory=_latest)
    cycle_times_s: deque[float] = field(default_factory=_latest)
    first_command_s: float | None = None

    def add(self, record: CycleRecord) -> None:
        """Take in one cycle."""
        self.cycles += 1
        for event in record.decision.events:
            self.events[event.kind.value] += 1
        stamp = record.observation.frame
        if stamp is None:
            return
        self.frames += 1
        if self.first_command_s is None:
            self.first_command_s = program_age_s()
        self.cycle_times_s.append(record.busy_s)
        self.data_ages_s.append(record.observation.now_s - stamp.captured_at_s + record.busy_s)
        for track in record.decision.tracks:
            statuses = self.track_statuses.get(track.target)
            if statuses is None:
                statuses = self.track_statuses[track.target] = Counter()
            statuses[track.status.value] += 1


def percentile(ordered: Sequence[float], share: float) -> float | None:
    """Return the value that this share (0 to 1) of the values does not exceed; None if there are none."""
    if not ordered:
        return None
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def program_age_s() -> float:
    """Return how long ago this process was started, by the system's own record, to a hundredth of a second."""
    after_name = Path("/proc/self/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    started_ticks = int(after_name[19])  # field 22, "starttime"; the second, the program's name, may contain spaces
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_ticks / os.sysconf("SC_CLK_TCK")


def peak_memory_mb() -> float:
    """Return the most memory that this program has had, in 10⁶ bytes.

    Not from `resource`: that counts the memory of the process which started this one, if it had more.
    """
    status = Path("/proc/self/status").read_text(encoding="utf-8", errors="replace")
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
