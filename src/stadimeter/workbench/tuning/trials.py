"""Trials of alarms, through the filter and the rules of a run: operating points of the target, and motions with noise.

An operating point is a distance at which the target stood while no alarm was right, given as its clearance from the
alarm's threshold in standard deviations of the noise there. The noise of a trial is that of calm stretches, put one
after the other in random order. Within a stretch everything is as it was: correlation, outliers, frames without the
target, and late frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision, EventKind
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import JournalError
from stadimeter.workbench.tuning.candidates import Tuned
from stadimeter.workbench.tuning.noise import Floats, RecordedNoise, Series

Truths = NDArray[np.bool_]

# A raise this close to a marked time is a true alarm.
EVENT_S = 5.0
POINTS = 20

# An operating point is the median of this time: shorter, and noise that lasts would count as one.
_CLEARLY_SIGMAS = 1.0
_TRUTH_S = 1.0
_STANDING_S = 5.0

# A target that crosses the threshold is clearly beyond it only a moment later.
_AROUND_S = 1.5


class OperatingPoints(Struct, frozen=True, kw_only=True, eq=False):
    """The distances at which a target stood while no alarm was right.

    Attributes:
        clearances: Distance from the threshold in each twentieth of that time, in standard deviations of the noise
            there; 0 at the threshold.
    """

    quiet_s: float
    clearances: Floats
    median_m: float

    @property
    def at_threshold(self) -> float:
        """The share of that time in which the target was within a standard deviation of the threshold."""
        return float(np.mean(self.clearances < _CLEARLY_SIGMAS))


def clearance_of(tuned: Tuned, noise: RecordedNoise, at_m: float) -> float:
    """Return the distance from the threshold, in standard deviations of the noise at `at_m`; negative beyond it."""
    return tuned.side * (at_m - tuned.threshold_m) / noise.true_m(at_m)


def distance_at(tuned: Tuned, noise: RecordedNoise, clearance: float) -> float | None:
    """Return the distance with a clearance, in metres; None if noise grows so fast with distance that there is none."""
    bend = clearance * noise.ratio * noise.stated_per_m2  # the distance d solves side · (d - limit) = bend · d²
    if bend == 0.0:
        return tuned.threshold_m
    root = 1 - 4 * tuned.side * bend * tuned.threshold_m
    if root < 0.05:
        return None
    return tuned.side * (1 - math.sqrt(root)) / (2 * bend)


def quiet_frames(series: Series, tuned: Tuned, noise: RecordedNoise, events_s: Sequence[float]) -> Truths:
    """Return for each frame whether the target was there and no alarm was right.

    Args:
        events_s: Capture times at which the alarm is right, besides those when the target was clearly beyond its
            threshold.
    """
    truth_m = truth_of(series)
    there = np.isfinite(truth_m)
    known_m = np.where(there, truth_m, tuned.threshold_m)
    beyond_m = tuned.side * (tuned.threshold_m - known_m)
    is_right = there & (beyond_m > _CLEARLY_SIGMAS * noise.ratio * noise.stated_per_m2 * known_m**2)
    marked_s = np.sort(np.array(events_s, dtype=np.float64))
    near = _within(series.times_s, series.times_s[is_right], _AROUND_S) | _within(series.times_s, marked_s, EVENT_S)
    quiet: Truths = there & ~near
    return quiet


def _within(times_s: Floats, marks_s: Floats, reach_s: float) -> Truths:
    """Return for each time whether one of the marks, which are in order, is near."""
    if not len(marks_s):
        return np.zeros(len(times_s), dtype=bool)
    first = np.searchsorted(marks_s, times_s - reach_s)
    near: Truths = first < np.searchsorted(marks_s, times_s + reach_s, side="right")
    return near


def truth_of(series: Series, around_s: float = _TRUTH_S) -> Floats:
    """Return the distance in each frame, in metres, smoothed by a median over `around_s`; NaN where it was not seen."""
    frame_s = float(np.median(np.diff(series.times_s))) if len(series.times_s) > 1 else 1.0
    half = max(1, round(around_s / frame_s / 2)) if frame_s > 0 else 1
    padded = np.pad(series.figures_m, half, constant_values=np.nan)
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)  # NaN comes last
    seen = np.isfinite(windows).sum(axis=1)
    middle = np.maximum(seen - 1, 0) // 2
    truth_m: Floats = np.where(seen > 0, windows[np.arange(len(windows)), middle], np.nan)
    return truth_m


def operating_points_of(
    recordings: Sequence[Series], quiet: Sequence[Truths], tuned: Tuned, noise: RecordedNoise
) -> OperatingPoints:
    """Return the operating points of recordings.

    Raises:
        JournalError: There is no such time.
    """
    figures_m = np.concatenate(
        [truth_of(each, _STANDING_S)[calm] for each, calm in zip(recordings, quiet, strict=True)]
    )
    if not len(figures_m):
        side = "nearer than" if tuned.side > 0 else "further than"
        raise JournalError(
            f"in all of the recordings the target is {side} {tuned.threshold_m:.2f} m, where an alarm of "
            f"'{tuned.rule.name}' is a true one; record it where it mostly stands, on the other side"
        )
    at_m = np.quantile(figures_m, (np.arange(POINTS) + 0.5) / POINTS)
    clearances = np.array([clearance_of(tuned, noise, float(each)) for each in at_m])
    return OperatingPoints(
        quiet_s=len(figures_m) * noise.frame_s,
        clearances=np.maximum(clearances, 0.0),
        median_m=float(np.median(figures_m)),
    )


# A target comes no nearer than this share of the threshold; one that goes away has stood there.
APPROACH_S, AFTER_S = 3.0, 2.0
MIN_DISTANCE_SHARE = 0.3


class Transition(Struct, frozen=True, kw_only=True):
    """An alarm was raised, or cleared."""

    at_s: float
    is_raise: bool


# The transitions of each alarm, by its name.
Transitions = Mapping[str, Sequence[Transition]]


class Trials:
    """Tries alarms."""

    def __init__(self, plan: Plan, noise: RecordedNoise, random: np.random.Generator) -> None:
        self._plan = plan
        self._noise = noise
        self._random = random

    def standing(self, rules: Sequence[AlarmRule], distance_m: float, frames: int) -> tuple[Transitions, float]:
        """Let the target stand, and return the transitions and the seconds that they took."""
        times_s, errors = self._frames(frames)
        seen = self._series(times_s, np.full(frames, distance_m), errors)
        return evaluate_alarms(self._plan, rules, seen), float(times_s[-1] - times_s[0])

    def crossing(self, rules: Sequence[AlarmRule], threshold_m: float, speed_mps: float, after_s: float) -> Transitions:
        """Let the target come, or go, over a threshold.

        Args:
            speed_mps: How fast the distance shrinks; negative if it grows.
            after_s: For how long to go on.

        Returns:
            The transitions. At the time 0 the true distance is the threshold.
        """
        nearest_m = MIN_DISTANCE_SHARE * threshold_m
        frames = math.ceil((APPROACH_S + after_s) / self._noise.frame_s)
        times_s, errors = self._frames(frames)
        crossed_s = times_s[0] + APPROACH_S + self._random.random() * self._noise.frame_s
        true_m = np.maximum(threshold_m - speed_mps * (times_s - crossed_s), nearest_m)
        transitions = evaluate_alarms(self._plan, rules, self._series(times_s, true_m, errors))
        return {
            name: [replace(transition, at_s=transition.at_s - crossed_s) for transition in each]
            for name, each in transitions.items()
        }

    def _frames(self, count: int) -> tuple[Floats, Floats]:
        calm, steps_s, errors, had = self._noise.calm, [], [], 0
        while had < count:
            stretch = calm[self._random.integers(len(calm))]
            first = int(self._random.integers(len(stretch.errors))) if not had else 0
            steps_s.append(stretch.steps_s[first:])
            errors.append(stretch.errors[first:])
            had += len(errors[-1])
        return np.cumsum(np.concatenate(steps_s)[:count]), np.concatenate(errors)[:count]

    def _series(self, times_s: Floats, true_m: Floats, errors: Floats) -> Series:
        noise = self._noise
        stated_m = np.maximum(noise.stated_per_m2 * true_m**2, noise.stated_m(0.0))
        figures_m = np.maximum(true_m + errors * stated_m, 0.2 * true_m)
        seen_m = np.where(np.isfinite(figures_m), figures_m, 1.0)
        return Series(
            times_s=times_s,
            figures_m=figures_m,
            noises_m=np.maximum(noise.stated_per_m2 * seen_m**2, noise.stated_m(0.0)),
            scale=noise.scale,
        )


def evaluate_alarms(plan: Plan, rules: Sequence[AlarmRule], series: Series) -> Transitions:
    """Evaluate several alarms on the same measurements."""
    target = rules[0].target
    tried = Plan(targets=(target,), rules=tuple(rules), tracking=plan.tracking, safety=plan.safety)
    transitions: dict[str, list[Transition]] = {rule.name: [] for rule in rules}
    for decision in _decisions(tried, target, series):
        for event in decision.events:
            if event.source in transitions and event.kind in {EventKind.RAISED, EventKind.CLEARED}:
                transitions[event.source].append(Transition(at_s=event.at_s, is_raise=event.kind is EventKind.RAISED))
    return transitions


def _decisions(plan: Plan, target: str, series: Series) -> Iterator[Decision]:
    state = initial_state(plan)
    rows = zip(series.times_s.tolist(), series.figures_m.tolist(), series.noises_m.tolist(), strict=True)
    for number, (at_s, figure_m, noise_m) in enumerate(rows):
        seen = _measurement(target, at_s, figure_m, noise_m, series.scale)
        frame = FrameStamp(sequence=number, captured_at_s=at_s)
        state, decision = decide(state, Observation(now_s=at_s, frame=frame, measurements=(seen,)))
        yield decision


def _measurement(target: str, at_s: float, figure_m: float, noise_m: float, scale: float) -> Measurement:
    if math.isnan(figure_m):
        return Measurement(target=target, status=MeasurementStatus.NOT_FOUND, captured_at_s=at_s, reason="not measured")
    return Measurement(
        target=target,
        status=MeasurementStatus.MEASURED,
        captured_at_s=at_s,
        distance_m=figure_m,
        depth_m=figure_m,
        sigma_m=math.hypot(noise_m, scale * figure_m),
        noise_m=noise_m,
        bearing_rad=0.0,
        elevation_rad=0.0,
    )


def raise_latency_s(transitions: Sequence[Transition]) -> float:
    """Measure how long after the time 0 an alarm stood: 0 if it did already, infinite if it was never raised."""
    is_active = False
    for transition in transitions:
        if transition.at_s >= 0 and (is_active or transition.is_raise):
            return 0.0 if is_active else transition.at_s
        is_active = transition.is_raise
    return 0.0 if is_active else math.inf


def end_latency_s(transitions: Sequence[Transition]) -> float:
    """Measure how long after the time 0 an alarm was over for good: 0 if it was before, infinite if it never was."""
    if not transitions or transitions[-1].is_raise:
        return math.inf if transitions else 0.0
    return max(0.0, transitions[-1].at_s)


def raises_apart(transitions: Sequence[Transition], apart_s: float) -> int:
    """Count how often an alarm was raised; raises that follow on each other at once count once.

    Args:
        apart_s: Within this time of the one before, it is the same.
    """
    count, last_s = 0, -math.inf
    for transition in transitions:
        if transition.is_raise:
            count += transition.at_s - last_s > apart_s
            last_s = transition.at_s
    return count
