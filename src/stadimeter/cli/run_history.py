"""What a live view remembers of a run: the last half minute of distances, the rate of frames, the last events."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.core.decision import Event
from stadimeter.core.track import Track

WINDOW_S = 30.0
"""For how long distances are remembered."""

SAMPLE_PERIOD_S = 0.05
"""Distances are kept this far apart: no terminal has the columns for more."""

RATE_WINDOW_S = 2.0
"""The rate of frames is counted over this time."""

EVENTS_MAX = 100
"""So many events are remembered: no terminal has the rows for more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A distance at a moment.

    Attributes:
        at_s: The moment, on the run's monotonic clock.
        distance_m: The filtered distance; None while there is none that may be acted on.
        sigma_m: Its standard deviation; 0 if unknown.
    """

    at_s: float
    distance_m: float | None
    sigma_m: float = 0.0


class RunHistory:
    """The recent past of a run, bounded in memory however long it lasts."""

    def __init__(self) -> None:
        self._samples: dict[str, deque[Sample]] = {}
        self._captured_s: deque[float] = deque()
        self._newest_frame_s: float | None = None
        self._tilts_rad: Mapping[str, float] = {}
        self._events: deque[Event] = deque(maxlen=EVENTS_MAX)
        self._started_s: float | None = None
        self._now_s = 0.0

    def add(self, record: CycleRecord) -> None:
        """Remember a cycle and forget what is too old.

        Args:
            record: The cycle; its time is not before that of the last one.
        """
        self._now_s = record.observation.now_s
        if self._started_s is None:
            self._started_s = self._now_s
        if record.observation.frame is not None:
            self._add_frame(record.observation.frame.captured_at_s)
            seen = record.observation.measurements
            self._tilts_rad = {each.target: each.tilt_rad for each in seen if each.tilt_rad is not None}
        while self._captured_s and self._captured_s[0] < self._now_s - RATE_WINDOW_S:
            self._captured_s.popleft()
        for track in record.decision.tracks:
            self._add_track(track)
        self._events.extendleft(record.decision.events)

    @property
    def started_s(self) -> float:
        """The time of the first cycle, on the run's monotonic clock; 0 before it."""
        return self._started_s or 0.0

    @property
    def frame_rate_hz(self) -> float:
        """How many frames a second came of late; 0 if none came."""
        if len(self._captured_s) < 2 or self._captured_s[-1] <= self._captured_s[0]:
            return 0.0
        return (len(self._captured_s) - 1) / (self._captured_s[-1] - self._captured_s[0])

    @property
    def frame_age_s(self) -> float | None:
        """How old the newest frame is; None before the first."""
        return None if self._newest_frame_s is None else max(0.0, self._now_s - self._newest_frame_s)

    @property
    def samples(self) -> Mapping[str, Sequence[Sample]]:
        """The distances of each target, oldest first."""
        return self._samples

    @property
    def tilts_rad(self) -> Mapping[str, float]:
        """How far each target that is flat, and was measured in the newest frame, is turned away."""
        return self._tilts_rad

    @property
    def events(self) -> Sequence[Event]:
        """The events, newest first."""
        return self._events

    def _add_frame(self, captured_at_s: float) -> None:
        self._newest_frame_s = captured_at_s
        self._captured_s.append(captured_at_s)

    def _add_track(self, track: Track) -> None:
        samples = self._samples.setdefault(track.target, deque())
        distance_m = track.distance_m if track.is_valid else None
        sample = Sample(at_s=self._now_s, distance_m=distance_m, sigma_m=track.sigma_m or 0.0)
        if not samples or _adds_something(samples[-1], sample):
            samples.append(sample)
        while samples[0].at_s < self._now_s - WINDOW_S:
            samples.popleft()


def _adds_something(last: Sample, sample: Sample) -> bool:
    if (last.distance_m is None) != (sample.distance_m is None):
        return True
    return sample.at_s - last.at_s >= SAMPLE_PERIOD_S - 1e-9
