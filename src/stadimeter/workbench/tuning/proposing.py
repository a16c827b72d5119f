"""Proposes settings of an alarm from recordings: no more false alarms than asked for, no more latency than needed.

When an alarm begins (probability, on-delay) trades false alarms against latency. When it ends (hysteresis, off-delay)
trades chattering against holding on. The two hardly depend on each other, so they are searched one after the other: a
few dozen settings in all, the same noise for each.

A recording by itself supports little: ten quiet minutes cannot tell an alarm with one false alarm a day from one with
none. So two figures are kept apart: the rate that the recordings alone support, and the rate to expect if the noise
goes on as it was recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from msgspec import Struct

from stadimeter.core.clock import DAY_S
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.workbench.tuning.noise import RecordedNoise, Series, noise_of
from stadimeter.workbench.tuning.trials import (
    AFTER_S,
    Count,
    OperatingPoints,
    Rate,
    Settings,
    Transition,
    Trials,
    Truths,
    Tuned,
    at_most,
    candidate_beginnings,
    candidate_endings,
    distance_at,
    end_latency_s,
    evaluate_alarms,
    operating_points_of,
    quiet_frames,
    raise_latency_s,
    raises_apart,
    rate_at,
    slope_of,
)

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
