"""All that a live view shows at one moment."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.cli.formatting import METRE, LengthUnit
from stadimeter.cli.keyboard import Key
from stadimeter.core.decision import Event
from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.core.message import Message
from stadimeter.core.track import Track


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """All that a live view shows at one moment.

    Attributes:
        started_s: The time of the first cycle, on the run's monotonic clock.
        frame_age_s: Age of the newest frame; None before the first.
        looked_at: Rejected candidates of each target that the newest frame does not show, the most like it first.
        samples: The recent distances of each target, oldest first.
        events: Newest first.
        messages: The messages to other programs, each with its time, newest first.
        trouble: A fault outside the loop, such as of the broker; empty if there is none.
        narration: What happens in a simulated world, in a sentence; empty if there is nothing to say.
        keys: The keys that do something; None if the view is no more than looked at.
        is_paused: Whether a key holds the run up.
        is_explained: Whether the screen is explained instead of shown.
    """

    title: str
    unit: LengthUnit = METRE
    record: CycleRecord | None = None
    started_s: float = 0.0
    frame_rate_hz: float = 0.0
    frame_age_s: float | None = None
    looked_at: Mapping[str, Sequence[RejectedCandidate]] = field(default_factory=dict)
    tilts_rad: Mapping[str, float] = field(default_factory=dict)
    samples: Mapping[str, Sequence[Sample]] = field(default_factory=dict)
    events: Sequence[Event] = ()
    messages: Sequence[tuple[float, Message]] = ()
    limits_m: Mapping[str, Sequence[float]] = field(default_factory=dict)
    trouble: str = ""
    narration: str = ""
    keys: Sequence[Key] | None = None
    is_paused: bool = False
    is_explained: bool = False


WINDOW_S = 30.0
"""For how long distances are remembered."""

SAMPLE_PERIOD_S = 0.05
"""Distances are kept this far apart: no terminal has the columns for more."""

RATE_WINDOW_S = 2.0
"""The rate of frames is counted over this time."""

EVENTS_MAX = 100
"""Limit of remembered events: no terminal has the rows for more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A distance at a moment.

    Attributes:
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
        """Frames a second, of late; 0 if none came."""
        if len(self._captured_s) < 2 or self._captured_s[-1] <= self._captured_s[0]:
            return 0.0
        return (len(self._captured_s) - 1) / (self._captured_s[-1] - self._captured_s[0])

    @property
    def frame_age_s(self) -> float | None:
        """Age of the newest frame; None before the first."""
        return None if self._newest_frame_s is None else max(0.0, self._now_s - self._newest_frame_s)

    @property
    def samples(self) -> Mapping[str, Sequence[Sample]]:
        """The distances of each target, oldest first."""
        return self._samples

    @property
    def tilts_rad(self) -> Mapping[str, float]:
        """Tilt of each flat target that was measured in the newest frame."""
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


class LookedAt:
    """The rejected candidates in the newest frame, for each target that was not measured in it."""

    def __init__(self) -> None:
        self._by_target: Mapping[str, Sequence[RejectedCandidate]] = {}

    def add(self, record: CycleRecord) -> None:
        """Take note of a cycle. One without a new frame leaves things as they were."""
        if record.observation.frame is None:
            return
        self._by_target = {
            measured.target: record.rejected.get(measured.target, ())
            for measured in record.observation.measurements
            if measured.status is not MeasurementStatus.MEASURED
        }

    @property
    def by_target(self) -> Mapping[str, Sequence[RejectedCandidate]]:
        """The candidates for each target that was not measured, the most like it first."""
        return self._by_target
