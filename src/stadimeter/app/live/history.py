"""Figures and the recent past of a run: bounded in memory however long the run lasts."""

from __future__ import annotations

import os
import time
from bisect import bisect_right
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct, field

from stadimeter.app.cycle import CycleRecord
from stadimeter.core.decision import Event
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Track
from stadimeter.core.observation import FrameStamp

# For how long distances are remembered.
WINDOW_S = 300.0

# Distances are kept this far apart: a chart of half a minute in a terminal, or of five on a page, has no room for
# more.
SAMPLE_PERIOD_S = 0.1

# The rate of frames is counted over this time.
RATE_WINDOW_S = 2.0

# Limit of remembered events. One who watches and does not read for long gets the newest of them.
EVENTS_MAX = 500

# Percentiles are over this many of the newest frames: a run of weeks needs no more memory than one of minutes.
TIMES_MAX = 10_000


class DistanceSample(NamedTuple):
    """A distance at a moment.

    Attributes:
        distance_m: The filtered distance; None while there is none that may be acted on.
        sigma_m: Its standard deviation; 0 if unknown.
    """

    at_s: float
    distance_m: float | None
    sigma_m: float = 0.0


class _Passed(NamedTuple):
    """A frame that was processed: when it was captured and processed on the run's clock, and processed in real time."""

    captured_at_s: float
    now_s: float
    real_s: float


class Seen(Struct, frozen=True, eq=False):
    """A frame, and the cycle in which it was new: what was found in exactly this frame."""

    record: CycleRecord
    frame: Frame | None


class RunHistory(Struct):
    """Counts, times and the recent past of a run.

    One thread adds; what is read is a copy, or one value, so that any thread may read.

    Attributes:
        started_s: The time of the first cycle, on the run's monotonic clock; 0 before it.
        record: The newest cycle.
        seen: The newest frame with its cycle.
        events: The events, newest first.
        frames: Cycles with a new frame.
        dropped_frames: How many frames the camera delivered that no cycle took, since the start.
        track_statuses: For each target, how many frames it spent in each status.
        event_counts: How many events of each kind.
        event_times_s: When each of the newest events was, on the clock of `time.monotonic`, by its time of the run.
        cycle_times_s: For the newest cycles with a frame, the computing time without waiting for the frame.
        data_ages_s: The age of their data when their commands had been applied.
        cycle_times_sum_s: Of all cycles with a frame; so is `data_ages_sum_s`.
        first_command_s: How old the program was when the commands of its first frame had been applied; None before.
        cycle_at_s: When the newest cycle was done, on the clock of `time.monotonic`; None before the first.
    """

    real_time_s: Callable[[], float] = time.monotonic
    started_s: float = 0.0
    record: CycleRecord | None = None
    seen: Seen | None = None
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENTS_MAX))
    cycles: int = 0
    frames: int = 0
    dropped_frames: int = 0
    track_statuses: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    event_counts: Counter[str] = field(default_factory=Counter)
    event_times_s: dict[float, float] = field(default_factory=dict)
    cycle_times_s: deque[float] = field(default_factory=lambda: deque(maxlen=TIMES_MAX))
    data_ages_s: deque[float] = field(default_factory=lambda: deque(maxlen=TIMES_MAX))
    cycle_times_sum_s: float = 0.0
    data_ages_sum_s: float = 0.0
    first_command_s: float | None = None
    cycle_at_s: float | None = None
    _samples: dict[str, deque[DistanceSample]] = field(default_factory=lambda: defaultdict(deque))
    _passed: deque[_Passed] = field(default_factory=deque)

    def add(self, record: CycleRecord, frame: Frame | None = None) -> None:
        """Take in a cycle and the frame that was new in it, and forget what is too old.

        Args:
            record: The cycle; its time is not before that of the last one.
        """
        now_s = record.observation.now_s
        if self.record is None:
            self.started_s = now_s
        self.record = record
        self.cycles += 1
        self.cycle_at_s = self.real_time_s()
        if record.observation.frame is not None:
            self._add_frame(record, frame, record.observation.frame, self.cycle_at_s)
        while self._passed and self._passed[0].captured_at_s < now_s - RATE_WINDOW_S:
            self._passed.popleft()
        for track in record.decision.tracks:
            self._add_track(now_s, track)
        for event in record.decision.events:
            self.events.appendleft(event)
            self.event_counts[event.kind.value] += 1
            self.event_times_s[event.at_s] = self.cycle_at_s
        while len(self.event_times_s) > EVENTS_MAX:
            del self.event_times_s[next(iter(self.event_times_s))]

    @property
    def frame_rate_hz(self) -> float:
        """Frames a second, of late; 0 if none came."""
        passed = tuple(self._passed)
        if len(passed) < 2 or passed[-1].captured_at_s <= passed[0].captured_at_s:
            return 0.0
        return (len(passed) - 1) / (passed[-1].captured_at_s - passed[0].captured_at_s)

    @property
    def speed(self) -> float | None:
        """The pace of the run's clock of late, in seconds a second; None if unknown."""
        passed = tuple(self._passed)
        if len(passed) < 2 or passed[-1].real_s <= passed[0].real_s:
            return None
        return (passed[-1].now_s - passed[0].now_s) / (passed[-1].real_s - passed[0].real_s)

    @property
    def frame_age_s(self) -> float | None:
        """Age of the newest frame in the newest cycle; None before the first."""
        stamp = self.seen.record.observation.frame if self.seen is not None else None
        if stamp is None or self.record is None:
            return None
        return max(0.0, self.record.observation.now_s - stamp.captured_at_s)

    def wall_clock(self, now_s: float, unix_now_s: float) -> Callable[[float], float]:
        """Return what gives moments of the run by the computer's clock, of which both show these times now.

        A run on a stepped clock may have fallen behind since: when an event was, is remembered.
        """
        real_now_s = self.real_time_s()

        def unix_s(at_s: float) -> float:
            real_s = self.event_times_s.get(at_s)
            return unix_now_s - (now_s - at_s if real_s is None else real_now_s - real_s)

        return unix_s

    def samples_after(self, at_s: float) -> Mapping[str, Sequence[DistanceSample]]:
        """Return the distances of each target after a time, oldest first."""
        return {target: newer(tuple(samples), at_s) for target, samples in tuple(self._samples.items())}

    def _add_frame(self, record: CycleRecord, frame: Frame | None, stamp: FrameStamp, real_s: float) -> None:
        before = self.seen.record.observation.frame if self.seen is not None else None
        if before is None:
            self.first_command_s = program_age_s()
        else:
            self.dropped_frames += max(0, stamp.sequence - before.sequence - 1)
        self.frames += 1
        self.seen = Seen(record, frame)
        self._passed.append(_Passed(stamp.captured_at_s, record.observation.now_s, real_s))
        self.cycle_times_s.append(record.busy_s)
        self.data_ages_s.append(record.observation.now_s - stamp.captured_at_s + record.busy_s)
        self.cycle_times_sum_s += self.cycle_times_s[-1]
        self.data_ages_sum_s += self.data_ages_s[-1]
        for track in record.decision.tracks:
            self.track_statuses[track.target][track.status.value] += 1

    def _add_track(self, now_s: float, track: Track) -> None:
        samples = self._samples[track.target]
        distance_m = track.distance_m if track.is_valid else None
        last = samples[-1] if samples else None
        is_change = last is None or (last.distance_m is None) != (distance_m is None)
        if last is None or is_change or now_s - last.at_s >= SAMPLE_PERIOD_S - 1e-9:
            samples.append(DistanceSample(at_s=now_s, distance_m=distance_m, sigma_m=track.sigma_m or 0.0))
            while samples[0].at_s < now_s - WINDOW_S:
                samples.popleft()


def newer(samples: Sequence[DistanceSample], at_s: float) -> Sequence[DistanceSample]:
    """Return the samples after a time, of some that are sorted by time."""
    return samples[bisect_right(samples, at_s, key=attrgetter("at_s")) :]


def program_age_s() -> float:
    """Return the time since this process was started, by the system's own record, to a hundredth of a second."""
    after_name = Path("/proc/self/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    started_ticks = int(after_name[19])  # field 22, "starttime"; the second, the program's name, may contain spaces
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_ticks / os.sysconf("SC_CLK_TCK")
