"""Proposes settings of an alarm from recordings: no more false alarms than asked for, no more latency than needed.

When an alarm begins (probability, on-delay) trades false alarms against latency. When it ends (hysteresis, off-delay)
trades chattering against holding on. The two hardly depend on each other, so they are searched one after the other: a
few dozen settings in all, the same noise for each.

A recording by itself supports little: ten quiet minutes cannot tell an alarm with one false alarm a day from one with
none. So two figures are kept apart: the rate that the recordings alone support, and the rate to expect if the noise
goes on as it was recorded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.config.loader import Configuration
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision, EventKind, Severity
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, OnDelay
from stadimeter.errors import ConfigError, JournalError, Problem
from stadimeter.workbench.tuning.noise import Floats, RecordedNoise, Series, noise_of

# Trials of alarms, through the filter and the rules of a run: operating points of the target, and motions with
# noise.
#
# An operating point is a distance at which the target stood while no alarm was right, given as its clearance from
# the alarm's threshold in standard deviations of the noise there. The noise of a trial is that of calm stretches,
# put one after the other in random order. Within a stretch everything is as it was: correlation, outliers, frames
# without the target, and late frames.

# The settings of an alarm that are tried, and how an alarm looks with them --------------------------------------------

PROBABILITIES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 0.999)
ON_DELAYS = (OnDelay(), OnDelay(frames=2, of_frames=3), OnDelay(frames=3, of_frames=5))
DEADBANDS_SIGMAS = (0.0, 1.0, 2.0, 3.0, 4.0)
OFF_DELAYS_S = (0.0, 0.5, 1.0, 2.0)


class Settings(Struct, frozen=True, kw_only=True):
    """The settings of an alarm that can be tuned.

    Attributes:
        probability: The probability of its condition from which it begins; None compares the figures alone.
        deadband_sigmas: Hysteresis: how far the target must come back, in standard deviations.
    """

    probability: float | None
    on_delay: OnDelay
    deadband_sigmas: float
    off_delay_s: float


class Tuned(Struct, frozen=True, kw_only=True):
    """The alarm that is tuned.

    Attributes:
        threshold_m: The threshold that the target may cross.
        side: 1 if the alarm is raised by a target that is nearer than the threshold, -1 if by one that is further.
    """

    rule: AlarmRule
    condition: DistanceCondition
    threshold_m: float
    side: int

    @property
    def settings(self) -> Settings:
        """The settings that it has."""
        return Settings(
            probability=self.condition.probability_on,
            on_delay=self.rule.on_delay,
            deadband_sigmas=self.condition.deadband_sigmas,
            off_delay_s=self.rule.off_delay_s,
        )

    def with_settings(self, settings: Settings, name: str) -> AlarmRule:
        """Return the alarm with other settings, and without all that does not say when it is raised."""
        on, off = settings.probability, self.condition.probability_off
        condition = replace(
            self.condition,
            probability_on=on,
            probability_off=off if on is None else min(off, on),
            deadband_sigmas=settings.deadband_sigmas,
        )
        return self._alarm(name, condition, settings.on_delay, settings.off_delay_s)

    def ending_at_once(self, settings: Settings, name: str) -> AlarmRule:
        """Return the alarm with these settings, but ending as soon as it can: so it is raised often enough to count."""
        on = settings.probability
        condition = replace(
            self.condition,
            probability_on=on,
            probability_off=0.5 if on is None else on,
            deadband=0.0,
            deadband_sigmas=0.0,
        )
        return self._alarm(name, condition, settings.on_delay, off_delay_s=0.0)

    def _alarm(self, name: str, condition: DistanceCondition, on_delay: OnDelay, off_delay_s: float) -> AlarmRule:
        return AlarmRule(
            name=name,
            target=condition.target,
            severity=self.rule.severity,
            lost=self.rule.lost,
            condition=condition,
            on_delay=on_delay,
            off_delay_s=off_delay_s,
            raises_per_min_max=0,  # each time that it comes is to be counted
        )


def candidate_beginnings(tuned: Tuned) -> list[Settings]:
    """Return the settings to try for when the alarm begins, its own first; a safety alarm does not wait."""
    delays = ON_DELAYS[:1] if tuned.rule.severity is Severity.SAFETY else ON_DELAYS
    tried = [
        replace(tuned.settings, probability=probability, on_delay=delay)
        for probability, delay in product(PROBABILITIES, delays)
    ]
    return _with_first(tuned.settings, tried)


def candidate_endings(begin: Settings) -> list[Settings]:
    """Return the settings to try for when the alarm ends, its own first, with the chosen beginning."""
    tried = [
        replace(begin, deadband_sigmas=band, off_delay_s=off_s)
        for band, off_s in product(DEADBANDS_SIGMAS, OFF_DELAYS_S)
    ]
    return _with_first(begin, tried)


def _with_first(first: Settings, others: Sequence[Settings]) -> list[Settings]:
    return [first, *(each for each in others if each != first)]


def rule_to_tune(configuration: Configuration, name: str, typical_m: float | None = None) -> Tuned:
    """Return the alarm to tune.

    Args:
        typical_m: The usual distance of the target. Of two thresholds, the one that is nearer to it is tuned.

    Raises:
        ConfigError: There is no such rule, or it is none on a distance alone.
    """
    rules = {rule.name: rule for rule in configuration.plan.rules}
    rule = rules.get(name)
    if rule is None:
        raise ConfigError([_problem(configuration, f"there is no rule '{name}'", did_you_mean_or_list(name, rules))])
    if not isinstance(rule, AlarmRule) or not isinstance(rule.condition, DistanceCondition):
        what = f"the rule '{name}' is none that a distance alone raises: only such alarms can be tuned"
        raise ConfigError([_problem(configuration, what, "its `when` must be above, below or between, and no more")])
    threshold_m, side = _limit(rule.condition, typical_m)
    return Tuned(rule=rule, condition=rule.condition, threshold_m=threshold_m, side=side)


def _limit(condition: DistanceCondition, typical_m: float | None) -> tuple[float, int]:
    limits = [(condition.below, 1), (condition.above, -1)]
    there = [(threshold_m, side) for threshold_m, side in limits if threshold_m is not None]
    return min(there, key=lambda each: 0.0 if typical_m is None else abs(math.log(each[0] / typical_m)))


def _problem(configuration: Configuration, message: str, hint: str) -> Problem:
    return Problem(message, file=str(configuration.path), hint=hint)


# Bootstrap draws of the counts, for the confidence of the line.
SURE = 0.95
DRAWS = 400

# Where nothing was counted, half a count stands for it: the logarithm of zero is not a number.
_SIGMAS_OF_SURE = 1.645
_HALF = 0.5

# An alarm gets rare where it is raised less than this share as often as anywhere.
OFTEN_SHARE = 0.5


class Count(Struct, frozen=True, kw_only=True):
    """The raises of an alarm while the target stood at one clearance.

    Attributes:
        clearance: Distance from the threshold, in standard deviations of the noise.
    """

    clearance: float
    raises: int
    duration_s: float


class Slope(Struct, frozen=True, kw_only=True):
    """The fall of the logarithm of a rate, for each standard deviation further away.

    Attributes:
        per_sigma: The change of the logarithm, zero or less.
    """

    per_sigma: float
    sigma: float


class Rate(Struct, frozen=True, kw_only=True):
    """False alarms a day.

    Attributes:
        at_most_a_day: It is at most this, with 95 % confidence, as far as the counts go.
    """

    a_day: float
    at_most_a_day: float


def at_most(count: int) -> float:
    """Return the 95 % upper limit of a Poisson variable's mean, where `count` events were counted.

    For none it is 3.0, the "rule of three". The formula is that of Wilson and Hilferty, "The distribution of
    chi-square", PNAS 17 (12), 1931.
    """
    more = count + 1
    return float(more * (1 - 1 / (9 * more) + _SIGMAS_OF_SURE / (3 * math.sqrt(more))) ** 3)


def slope_of(all_counts: Iterable[Sequence[Count]]) -> Slope:
    """Return the slope that all settings have together."""
    tails = [_tail(counts) for counts in all_counts]
    rise = spread = 0.0
    for at, raises, duration_s in tails:
        logs = np.log(raises / duration_s)
        off = at - np.average(at, weights=raises)
        rise += float(np.sum(raises * off * logs))
        spread += float(np.sum(raises * off * off))
    # All settings were tried on the same noise: together they tell no more than one of them.
    return Slope(per_sigma=min(rise / spread, 0.0), sigma=math.sqrt(len(tails) / spread))


def rate_at(
    counts: Sequence[Count], slope: Slope, clearances: Floats, far: Count | None, random: np.random.Generator
) -> Rate:
    """Compute how often a day an alarm is raised by a target that spends the same time at each clearance.

    Args:
        counts: By growing clearance.
        clearances: Distances from the threshold, in standard deviations of the noise.
        far: The count at the median clearance, if that is further away than all else; else None.
    """
    at, raises, duration_s = _tail(counts)
    nearer = np.array(
        [count.raises / count.duration_s for count in counts if count.clearance < at[0]], dtype=np.float64
    )
    most_often = max(float(nearer.max(initial=0.0)), raises[0] / duration_s[0])
    likeliest = _a_day((at, raises, duration_s), slope.per_sigma, clearances, most_often)
    slopes = np.minimum(random.normal(slope.per_sigma, slope.sigma, DRAWS), 0.0)
    # A parametric bootstrap: counts and slope are drawn anew; the 95th percentile of the drawn rates is the limit.
    again = np.maximum(random.poisson(raises, (DRAWS, len(raises))), _HALF)
    drawn = [
        _a_day((at, each, duration_s), float(by), clearances, most_often)
        for each, by in zip(again, slopes, strict=True)
    ]
    most = float(np.quantile(drawn, SURE))
    if far is not None and far.raises:
        likeliest = max(likeliest, far.raises / far.duration_s * DAY_S)
        most = max(most, at_most(far.raises) / far.duration_s * DAY_S)
    return Rate(a_day=likeliest, at_most_a_day=max(likeliest, most))


def _tail(counts: Sequence[Count]) -> tuple[Floats, Floats, Floats]:
    """Return clearances, raises and durations, from where it gets rare to where it is never raised.

    Nearer than that it is raised about as often wherever the target stands, or more seldom because it hardly ever ends.
    """
    raises = [count.raises for count in counts]
    often = max(index for index, each in enumerate(raises) if each >= OFTEN_SHARE * max(raises))
    first = min(often, len(raises) - 2)
    empty = next((index for index in range(first, len(raises)) if not raises[index]), len(raises) - 1)
    used = counts[first : max(empty + 1, first + 2)]
    return (
        np.array([count.clearance for count in used]),
        np.array([max(count.raises, _HALF) for count in used]),
        np.array([count.duration_s for count in used]),
    )


def _a_day(tail: tuple[Floats, Floats, Floats], per_sigma: float, clearances: Floats, most_often: float) -> float:
    """Return the rate, by the line, and nowhere more than where it is raised most often."""
    at, raises, duration_s = tail
    # The likeliest height of a Poisson rate exp(height + slope · clearance), given the slope: counts over exposure.
    height = math.log(raises.sum() / np.sum(duration_s * np.exp(per_sigma * at)))
    rates = np.minimum(np.exp(height + per_sigma * clearances), most_often)
    return float(DAY_S * np.mean(rates))


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


# An alarm with its target at the threshold may end and begin again at most this often, or it chatters.
CLEARANCES = (-1.5, -0.75, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5)
FRAMES_A_CLEARANCE = 3000
CROSSINGS = 60
HOVER_FRAMES = 8_000
FLAPS_A_MINUTE = 0.1

# Raises that follow on each other at once are one.
APART_S = 1.0

# Settings that differ by less than this are as late as each other.
ENDS_WITHIN_S = 5.0
AS_LATE_S = 0.002


# Settings by the name of the alarm that has them.
Tried = Mapping[str, Settings]

# The transitions of each alarm, by its name, once for each time that the target crossed its threshold.
Crossings = dict[str, list[Sequence[Transition]]]


class Beginning(Struct, frozen=True, kw_only=True):
    """Settings for when an alarm begins, and their figures.

    Attributes:
        rate: False alarms a day, if the noise goes on as it was recorded.
        recorded_raises: False alarms that the recordings would have had.
        late_s: Mean latency for a target that comes at the closing speed.
    """

    settings: Settings
    rate: Rate
    recorded_raises: int
    late_s: float
    late_p95_s: float


class Ending(Struct, frozen=True, kw_only=True):
    """Settings for when an alarm ends, and their figures.

    Attributes:
        flaps_a_minute: Times that it ends and begins again while the target stays at the threshold.
        ends_after_s: Mean time from the target's leaving, at the closing speed, to the end of the alarm.
    """

    settings: Settings
    flaps_a_minute: float
    ends_after_s: float


class Proposal(Struct, frozen=True, kw_only=True, eq=False):
    """The proposed settings, and all that they rest on.

    Attributes:
        speed_mps: The closing speed that latency is for.
        endings: All that were tried, with the proposed beginning; the rule's own first.
        points: Where the target stood while no alarm was right.
    """

    tuned: Tuned
    noise: RecordedNoise
    wanted_a_day: float
    speed_mps: float
    beginnings: tuple[Beginning, ...]
    begin: Beginning
    endings: tuple[Ending, ...]
    end: Ending
    points: OperatingPoints

    @property
    def is_reached(self) -> bool:
        """True if the proposal is expected to have no more false alarms than were asked for."""
        return self.begin.rate.a_day <= self.wanted_a_day

    @property
    def supported_a_day(self) -> float:
        """The 95 % upper limit of false alarms a day that the recordings alone give for the proposal."""
        return at_most(self.begin.recorded_raises) / self.points.quiet_s * DAY_S

    @property
    def is_supported(self) -> bool:
        """True if the recordings alone support the rate that was asked for."""
        return self.supported_a_day <= self.wanted_a_day

    @property
    def is_extrapolated(self) -> bool:
        """True if the target stood further away than where false alarms could be counted."""
        return float(self.points.clearances.min()) > CLEARANCES[-1]


def tune(  # noqa: PLR0913 - what is asked for
    tuned: Tuned,
    plan: Plan,
    recordings: Sequence[Series],
    *,
    wanted_a_day: float,
    speed_mps: float,
    events_s: Sequence[float] = (),
    seed: int = 0,
) -> Proposal:
    """Propose settings.

    Args:
        speed_mps: The closing speed of the target, for latency.
        events_s: Capture times at which the alarm is right to be raised, besides those when the target has crossed the
            threshold clearly.
        seed: The same seed gives the same proposal.

    Raises:
        JournalError: The recordings do not tell the noise, or have no time without a true alarm.
    """
    noise = noise_of(recordings)
    quiet = [quiet_frames(series, tuned, noise, events_s) for series in recordings]
    points = operating_points_of(recordings, quiet, tuned, noise)
    search = _Search(tuned, plan, noise, speed_mps, np.random.default_rng(seed))
    recorded = partial(search.recorded_raises, recordings, quiet)
    begins = search.beginnings(points, recorded)
    begin = choose_beginning(begins, wanted_a_day, points.quiet_s)
    ends = search.endings(begin.settings)
    return Proposal(
        tuned=tuned,
        noise=noise,
        wanted_a_day=wanted_a_day,
        speed_mps=speed_mps,
        beginnings=tuple(begins),
        begin=begin,
        endings=tuple(ends),
        end=choose_ending(ends),
        points=points,
    )


def choose_beginning(tried: Sequence[Beginning], wanted_a_day: float, quiet_s: float) -> Beginning:
    """Return the earliest beginning with few enough false alarms; if there is none, the one with the fewest.

    Args:
        quiet_s: The time without a true alarm in the recordings.
    """
    most = wanted_a_day * quiet_s / DAY_S
    allowed = [each for each in tried if each.rate.a_day <= wanted_a_day and each.recorded_raises <= most]
    if not allowed:
        return min(tried, key=lambda each: (each.recorded_raises, each.rate.a_day))
    return min(allowed, key=lambda each: (round(each.late_s / AS_LATE_S), each.rate.a_day))


def choose_ending(tried: Sequence[Ending]) -> Ending:
    """Return the earliest ending that does not chatter; if all do, the one that chatters least."""
    allowed = [each for each in tried if each.flaps_a_minute <= FLAPS_A_MINUTE]
    if not allowed:
        return min(tried, key=lambda each: each.flaps_a_minute)
    return min(allowed, key=lambda each: (round(each.ends_after_s / AS_LATE_S), each.flaps_a_minute))


class _Search:
    """Tries settings of one alarm."""

    def __init__(
        self, tuned: Tuned, plan: Plan, noise: RecordedNoise, speed_mps: float, random: np.random.Generator
    ) -> None:
        self._tuned = tuned
        self._plan = plan
        self._noise = noise
        self._speed_mps = speed_mps * tuned.side
        self._random = random
        self._trials = Trials(plan, noise, random)

    def beginnings(self, points: OperatingPoints, recorded: Callable[[Tried], Mapping[str, int]]) -> list[Beginning]:
        tried = _with_names(candidate_beginnings(self._tuned))
        counts, late, raises = self._counts(tried, CLEARANCES), self._late(tried), recorded(tried)
        slope, far = slope_of(counts.values()), self._far(tried, float(np.median(points.clearances)))
        return [
            Beginning(
                settings=settings,
                rate=rate_at(counts[name], slope, points.clearances, far.get(name), self._random),
                recorded_raises=raises[name],
                late_s=float(np.mean(late[name])),
                late_p95_s=float(np.quantile(late[name], 0.95)),
            )
            for name, settings in tried.items()
        ]

    def recorded_raises(self, recordings: Sequence[Series], quiet: Sequence[Truths], tried: Tried) -> Mapping[str, int]:
        """Count the false alarms that each alarm would have had in the recordings."""
        counts = dict.fromkeys(tried, 0)
        for series, is_quiet in zip(recordings, quiet, strict=True):
            quiet_s = set(series.times_s[is_quiet].tolist())
            for name, transitions in evaluate_alarms(self._plan, self._rules(tried), series).items():
                counts[name] += sum(transition.is_raise and transition.at_s in quiet_s for transition in transitions)
        return counts

    def endings(self, begin: Settings) -> list[Ending]:
        tried = _with_names(candidate_endings(begin))
        hovering, duration_s = self._trials.standing(self._rules(tried), self._tuned.threshold_m, HOVER_FRAMES)
        ends = self._crossings(tried, -self._speed_mps, CROSSINGS // 2, ENDS_WITHIN_S)
        return [
            Ending(
                settings=settings,
                flaps_a_minute=sum(not transition.is_raise for transition in hovering[name]) / duration_s * 60,
                ends_after_s=float(
                    np.mean([min(end_latency_s(transitions), ENDS_WITHIN_S) for transitions in ends[name]])
                ),
            )
            for name, settings in tried.items()
        ]

    def _rules(self, tried: Tried) -> list[AlarmRule]:
        return [self._tuned.with_settings(settings, name) for name, settings in tried.items()]

    def _far(self, tried: Tried, clearance: float) -> dict[str, Count]:
        """Count at the median operating point, if that is further away than all clearances that are tried anyway."""
        if clearance <= CLEARANCES[-1]:
            return {}
        return {name: each[0] for name, each in self._counts(tried, (clearance,)).items() if each}

    def _counts(self, tried: Tried, clearances: Sequence[float]) -> dict[str, list[Count]]:
        """Count how often each alarm is raised by a target that stands still at some clearances."""
        rules = [self._tuned.ending_at_once(settings, name) for name, settings in tried.items()]
        counts: dict[str, list[Count]] = {name: [] for name in tried}
        for clearance in clearances:
            at_m = distance_at(self._tuned, self._noise, clearance)
            if at_m is None:
                break
            transitions, duration_s = self._trials.standing(rules, at_m, FRAMES_A_CLEARANCE)
            for name, each in transitions.items():
                raises = raises_apart(each, APART_S)
                counts[name].append(Count(clearance=clearance, raises=raises, duration_s=duration_s))
        return counts

    def _late(self, tried: Tried) -> dict[str, list[float]]:
        crossings = self._crossings(tried, self._speed_mps, CROSSINGS, AFTER_S)
        return {
            name: [min(raise_latency_s(transitions), AFTER_S) for transitions in each]
            for name, each in crossings.items()
        }

    def _crossings(
        self, tried: Tried, speed_mps: float, times: int, after_s: float
    ) -> dict[str, list[Sequence[Transition]]]:
        rules = self._rules(tried)
        found: Crossings = {name: [] for name in tried}
        for _ in range(times):
            for name, transitions in self._trials.crossing(rules, self._tuned.threshold_m, speed_mps, after_s).items():
                found[name].append(transitions)
        return found


def _with_names(tried: Sequence[Settings]) -> Tried:
    return {f"candidate-{number}": settings for number, settings in enumerate(tried)}
