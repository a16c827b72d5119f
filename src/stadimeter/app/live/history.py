"""The recent past of a run, for those who watch it: bounded in memory however long the run lasts."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from stadimeter.app.cycle import CycleRecord
from stadimeter.core.decision import Event
from stadimeter.core.frame import Frame
from stadimeter.core.track import Track

# For how long distances are remembered.
WINDOW_S = 300.0

# Distances are kept this far apart: a chart of half a minute in a terminal, or of five on a page, has no room for
# more.
SAMPLE_PERIOD_S = 0.1

# The rate of frames is counted over this time.
RATE_WINDOW_S = 2.0

# Limit of remembered events. One who watches and does not read for long gets the newest of them.
EVENTS_MAX = 500

# Percentiles are over this many of the newest frames: ten seconds of a camera.
TIMES_MAX = 300

_FIELDS = 3


class DistanceSample(NamedTuple):
    """A distance at a moment.

    Attributes:
        distance_m: The filtered distance; None while there is none that may be acted on.
        sigma_m: Its standard deviation; 0 if unknown.
    """

    at_s: float
    distance_m: float | None
    sigma_m: float = 0.0


class Samples(Sequence[DistanceSample]):
    """Distances over time, oldest first, in 24 bytes each.

    One thread adds, any thread may take a copy with `after`: each step is a single operation on one array, which the
    interpreter does not divide.
    """

    __slots__ = ("_numbers",)

    def __init__(self, numbers: array[float] | None = None) -> None:
        self._numbers = array("d") if numbers is None else numbers

    def __len__(self) -> int:
        return len(self._numbers) // _FIELDS

    def __getitem__(self, index: int) -> DistanceSample:  # type: ignore[override] # for slices there is `after`
        first = range(0, len(self._numbers), _FIELDS)[index]
        at_s, distance_m, sigma_m = self._numbers[first : first + _FIELDS]
        return DistanceSample(at_s=at_s, distance_m=None if math.isnan(distance_m) else distance_m, sigma_m=sigma_m)

    def __iter__(self) -> Iterator[DistanceSample]:
        return (self[index] for index in range(len(self)))

    def rows(self) -> Iterator[tuple[float, float, float]]:
        """Yield time, distance (NaN for none) and standard deviation of each, for those who need them quickly."""
        each = iter(self._numbers)
        return zip(each, each, each, strict=True)

    def append(self, sample: DistanceSample) -> None:
        """Add the newest one."""
        distance_m = math.nan if sample.distance_m is None else sample.distance_m
        self._numbers.extend((sample.at_s, distance_m, sample.sigma_m))

    def forget_before(self, at_s: float) -> None:
        """Forget what is older."""
        while self._numbers and self._numbers[0] < at_s:
            del self._numbers[:_FIELDS]

    def after(self, at_s: float) -> Samples:
        """Return a copy of what is newer."""
        numbers = self._numbers[:]
        return Samples(numbers[_FIELDS * bisect_right(numbers[::_FIELDS], at_s) :])


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A frame, and the cycle in which it was new: what was found in exactly this frame."""

    record: CycleRecord
    frame: Frame | None


@dataclass(slots=True)
class RunHistory:
    """The recent past of a run.

    One thread adds; what is read is a copy, or one value, so that any thread may read.

    Attributes:
        started_s: The time of the first cycle, on the run's monotonic clock; 0 before it.
        record: The newest cycle.
        seen: The newest frame with its cycle.
        events: The events, newest first.
        dropped_frames: How many frames the camera delivered that no cycle took, since the start.
        cycle_times_s: The computing time of the newest cycles with a frame.
        data_ages_s: The age of their data when their commands had been applied.
    """

    started_s: float = 0.0
    record: CycleRecord | None = None
    seen: Seen | None = None
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENTS_MAX))
    dropped_frames: int = 0
    cycle_times_s: deque[float] = field(default_factory=lambda: deque(maxlen=TIMES_MAX))
    data_ages_s: deque[float] = field(default_factory=lambda: deque(maxlen=TIMES_MAX))
    _samples: dict[str, Samples] = field(default_factory=dict)
    _captured_s: deque[float] = field(default_factory=deque)
    _sequence: int | None = None

    def add(self, record: CycleRecord, frame: Frame | None = None) -> None:
        """Remember a cycle and the frame that was new in it, and forget what is too old.

        Args:
            record: The cycle; its time is not before that of the last one.
        """
        now_s = record.observation.now_s
        if self.record is None:
            self.started_s = now_s
        self.record = record
        if record.observation.frame is not None:
            self._add_frame(record, frame, record.observation.frame.sequence)
        while self._captured_s and self._captured_s[0] < now_s - RATE_WINDOW_S:
            self._captured_s.popleft()
        for track in record.decision.tracks:
            self._add_track(now_s, track)
        self.events.extendleft(record.decision.events)

    @property
    def frame_rate_hz(self) -> float:
        """Frames a second, of late; 0 if none came."""
        captured_s = tuple(self._captured_s)
        if len(captured_s) < 2 or captured_s[-1] <= captured_s[0]:
            return 0.0
        return (len(captured_s) - 1) / (captured_s[-1] - captured_s[0])

    @property
    def frame_age_s(self) -> float | None:
        """Age of the newest frame in the newest cycle; None before the first."""
        stamp = self.seen.record.observation.frame if self.seen is not None else None
        if stamp is None or self.record is None:
            return None
        return max(0.0, self.record.observation.now_s - stamp.captured_at_s)

    def samples_after(self, at_s: float) -> Mapping[str, Samples]:
        """Return the distances of each target after a time, oldest first."""
        return {target: samples.after(at_s) for target, samples in tuple(self._samples.items())}

    def _add_frame(self, record: CycleRecord, frame: Frame | None, sequence: int) -> None:
        stamp = record.observation.frame
        if stamp is None:
            return
        if self._sequence is not None:
            self.dropped_frames += max(0, sequence - self._sequence - 1)
        self._sequence = sequence
        self.seen = Seen(record, frame)
        self._captured_s.append(stamp.captured_at_s)
        self.cycle_times_s.append(record.busy_s)
        self.data_ages_s.append(record.observation.now_s - stamp.captured_at_s + record.busy_s)

    def _add_track(self, now_s: float, track: Track) -> None:
        samples = self._samples.get(track.target)
        if samples is None:
            samples = self._samples[track.target] = Samples()
        distance_m = track.distance_m if track.is_valid else None
        last = samples[-1] if samples else None
        is_change = last is None or (last.distance_m is None) != (distance_m is None)
        if last is None or is_change or now_s - last.at_s >= SAMPLE_PERIOD_S - 1e-9:
            samples.append(DistanceSample(at_s=now_s, distance_m=distance_m, sigma_m=track.sigma_m or 0.0))
            samples.forget_before(now_s - WINDOW_S)
