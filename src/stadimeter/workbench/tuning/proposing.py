"""Proposes settings of an alarm from recordings: raised for nothing as seldom as is asked for, no later than needed.

When an alarm begins (its probability and its on-delay) is a trade of false alarms against lateness, and when it ends
(its band and its off-delay) is one of flapping against holding on. The two hardly touch each other, so they are tried
one after the other: a few dozen settings in all, the same noise for each.

What a recording supports by itself is little: in ten quiet minutes there is no difference between an alarm that is
raised for nothing once a day and one that never is. So two figures are told apart: what the recordings alone support,
and what is to be expected if the noise goes on as it was recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.workbench.tuning.candidates import Settings, Tuned, beginnings, endings
from stadimeter.workbench.tuning.noise import Noise, Sights, noise_of
from stadimeter.workbench.tuning.places import Places, Truths, place_of, places_of, quiet_frames
from stadimeter.workbench.tuning.rates import DAY_S, Count, Rate, at_most, rate_at, slope_of
from stadimeter.workbench.tuning.trials import AFTER_S, Trials, Turn, ended_s, judged, late_s, raises_apart

CLEARANCES = (-1.5, -0.75, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5)
FRAMES_A_CLEARANCE = 3000
CROSSINGS = 60
HOVER_FRAMES = 8_000
FLAPS_A_MINUTE = 0.1
"""An alarm may be raised again so often while its target hovers at the threshold: once in ten minutes."""
APART_S = 1.0
"""Raises that follow on each other at once are one."""
ENDS_WITHIN_S = 5.0
AS_LATE_S = 0.002
"""Settings that differ by less than this are as late as each other."""


Tried = Mapping[str, Settings]
"""Settings by the name of the alarm that has them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beginning:
    """What comes of the settings for when an alarm begins.

    Attributes:
        rate: How often a day it is raised for nothing, if the noise goes on as it was recorded.
        recorded_raises: How often it would have been raised for nothing in the recordings.
        late_s: How late it is, on the mean, for a target that comes at the closing speed.
        late_p95_s: 95 in 100 are no later.
    """

    settings: Settings
    rate: Rate
    recorded_raises: int
    late_s: float
    late_p95_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """What comes of the settings for when an alarm ends.

    Attributes:
        flaps_a_minute: How often it ends and begins again while the target hovers at the threshold.
        ends_after_s: How long after the target has left it ends, on the mean, at the closing speed.
    """

    settings: Settings
    flaps_a_minute: float
    ends_after_s: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Proposal:
    """What is proposed, and why.

    Attributes:
        noise: What the recordings tell of the noise.
        wanted_a_day: How many false alarms a day were asked for.
        speed_mps: The closing speed that lateness is for.
        beginnings: All that were tried, the rule's own first.
        endings: All that were tried, with the proposed beginning; the rule's own first.
        places: Where the target stood while no alarm was right.
    """

    tuned: Tuned
    noise: Noise
    wanted_a_day: float
    speed_mps: float
    beginnings: tuple[Beginning, ...]
    begin: Beginning
    endings: tuple[Ending, ...]
    end: Ending
    places: Places

    @property
    def is_reached(self) -> bool:
        """Whether the proposal is expected to be raised for nothing no more often than was asked for."""
        return self.begin.rate.a_day <= self.wanted_a_day

    @property
    def supported_a_day(self) -> float:
        """What the recordings alone support, with 95 % confidence, of the proposal."""
        return at_most(self.begin.recorded_raises) / self.places.quiet_s * DAY_S

    @property
    def is_supported(self) -> bool:
        """Whether the recordings alone support what was asked for."""
        return self.supported_a_day <= self.wanted_a_day

    @property
    def is_extrapolated(self) -> bool:
        """Whether the target stood further away than where false alarms could be counted."""
        return float(self.places.clearances.min()) > CLEARANCES[-1]


def tune(  # noqa: PLR0913 - what is asked for
    tuned: Tuned,
    plan: Plan,
    recordings: Sequence[Sights],
    *,
    wanted_a_day: float,
    speed_mps: float,
    events_s: Sequence[float] = (),
    seed: int = 0,
) -> Proposal:
    """Propose settings.

    Args:
        recordings: What was measured of its target.
        wanted_a_day: How many false alarms a day are allowed.
        speed_mps: How fast the target comes, for lateness.
        events_s: Capture times at which the alarm is right to be raised, besides those when the target has crossed the
            limit clearly.
        seed: What random numbers begin with. The same seed gives the same proposal.

    Raises:
        JournalError: The recordings do not tell the noise, or have no time without a true alarm.
    """
    noise = noise_of(recordings)
    quiet = [quiet_frames(sights, tuned, noise, events_s) for sights in recordings]
    places = places_of(recordings, quiet, tuned, noise)
    search = _Search(tuned, plan, noise, speed_mps, np.random.default_rng(seed))
    recorded = partial(search.recorded_raises, recordings, quiet)
    begins = search.beginnings(places, recorded)
    begin = chosen_beginning(begins, wanted_a_day, places.quiet_s)
    ends = search.endings(begin.settings)
    return Proposal(
        tuned=tuned,
        noise=noise,
        wanted_a_day=wanted_a_day,
        speed_mps=speed_mps,
        beginnings=tuple(begins),
        begin=begin,
        endings=tuple(ends),
        end=chosen_ending(ends),
        places=places,
    )


def chosen_beginning(tried: Sequence[Beginning], wanted_a_day: float, quiet_s: float) -> Beginning:
    """Return the earliest beginning that is seldom enough raised for nothing; if none is, the one most seldom raised.

    Args:
        wanted_a_day: How many false alarms a day are allowed.
        quiet_s: How much time the recordings have without a true alarm.
    """
    most = wanted_a_day * quiet_s / DAY_S
    allowed = [each for each in tried if each.rate.a_day <= wanted_a_day and each.recorded_raises <= most]
    if not allowed:
        return min(tried, key=lambda each: (each.recorded_raises, each.rate.a_day))
    return min(allowed, key=lambda each: (round(each.late_s / AS_LATE_S), each.rate.a_day))


def chosen_ending(tried: Sequence[Ending]) -> Ending:
    """Return the earliest ending that does not flap; if all do, the one that flaps least."""
    allowed = [each for each in tried if each.flaps_a_minute <= FLAPS_A_MINUTE]
    if not allowed:
        return min(tried, key=lambda each: each.flaps_a_minute)
    return min(allowed, key=lambda each: (round(each.ends_after_s / AS_LATE_S), each.flaps_a_minute))


class _Search:
    """Tries settings of one alarm."""

    def __init__(self, tuned: Tuned, plan: Plan, noise: Noise, speed_mps: float, random: np.random.Generator) -> None:
        self._tuned = tuned
        self._plan = plan
        self._noise = noise
        self._speed_mps = speed_mps * tuned.side
        self._random = random
        self._trials = Trials(plan, noise, random)

    def beginnings(self, places: Places, recorded: Callable[[Tried], Mapping[str, int]]) -> list[Beginning]:
        tried = _named(beginnings(self._tuned))
        counts, late, raises = self._counts(tried, CLEARANCES), self._late(tried), recorded(tried)
        slope, far = slope_of(counts.values()), self._far(tried, float(np.median(places.clearances)))
        return [
            Beginning(
                settings=settings,
                rate=rate_at(counts[name], slope, places.clearances, far.get(name), self._random),
                recorded_raises=raises[name],
                late_s=float(np.mean(late[name])),
                late_p95_s=float(np.quantile(late[name], 0.95)),
            )
            for name, settings in tried.items()
        ]

    def recorded_raises(self, recordings: Sequence[Sights], quiet: Sequence[Truths], tried: Tried) -> Mapping[str, int]:
        """Count how often each alarm would have been raised for nothing in the recordings."""
        counts = dict.fromkeys(tried, 0)
        for sights, is_quiet in zip(recordings, quiet, strict=True):
            quiet_s = set(sights.times_s[is_quiet].tolist())
            for name, turns in judged(self._plan, self._rules(tried), sights).items():
                counts[name] += sum(turn.is_raise and turn.at_s in quiet_s for turn in turns)
        return counts

    def endings(self, begin: Settings) -> list[Ending]:
        tried = _named(endings(begin))
        hovering, duration_s = self._trials.standing(self._rules(tried), self._tuned.limit_m, HOVER_FRAMES)
        ends = self._crossings(tried, -self._speed_mps, CROSSINGS // 2, ENDS_WITHIN_S)
        return [
            Ending(
                settings=settings,
                flaps_a_minute=sum(not turn.is_raise for turn in hovering[name]) / duration_s * 60,
                ends_after_s=float(np.mean([min(ended_s(turns), ENDS_WITHIN_S) for turns in ends[name]])),
            )
            for name, settings in tried.items()
        ]

    def _rules(self, tried: Tried) -> list[AlarmRule]:
        return [self._tuned.with_settings(settings, name) for name, settings in tried.items()]

    def _far(self, tried: Tried, clearance: float) -> dict[str, Count]:
        """Count where the target mostly stood, if that is further away than all places that are tried anyway."""
        if clearance <= CLEARANCES[-1]:
            return {}
        return {name: each[0] for name, each in self._counts(tried, (clearance,)).items() if each}

    def _counts(self, tried: Tried, clearances: Sequence[float]) -> dict[str, list[Count]]:
        """Count how often each alarm is raised, of a target that stands in some places."""
        rules = [self._tuned.ending_at_once(settings, name) for name, settings in tried.items()]
        counts: dict[str, list[Count]] = {name: [] for name in tried}
        for clearance in clearances:
            at_m = place_of(self._tuned, self._noise, clearance)
            if at_m is None:
                break
            turns, duration_s = self._trials.standing(rules, at_m, FRAMES_A_CLEARANCE)
            for name, each in turns.items():
                raises = raises_apart(each, APART_S)
                counts[name].append(Count(clearance=clearance, raises=raises, duration_s=duration_s))
        return counts

    def _late(self, tried: Tried) -> dict[str, list[float]]:
        crossings = self._crossings(tried, self._speed_mps, CROSSINGS, AFTER_S)
        return {name: [min(late_s(turns), AFTER_S) for turns in each] for name, each in crossings.items()}

    def _crossings(self, tried: Tried, speed_mps: float, times: int, after_s: float) -> dict[str, list[Sequence[Turn]]]:
        rules = self._rules(tried)
        found: dict[str, list[Sequence[Turn]]] = {name: [] for name in tried}
        for _ in range(times):
            for name, turns in self._trials.crossing(rules, self._tuned.limit_m, speed_mps, after_s).items():
                found[name].append(turns)
        return found


def _named(tried: Sequence[Settings]) -> Tried:
    return {f"candidate-{number}": settings for number, settings in enumerate(tried)}
