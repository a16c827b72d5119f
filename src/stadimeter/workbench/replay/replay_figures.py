"""Figures of rules over a recording: how often they changed, how late they were, what they missed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from statistics import median

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Decision, Event, EventKind, RuleTrace
from stadimeter.core.measurement import Track
from stadimeter.core.observation import Observation
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule

# A distance is the mean of those measured within this before and after.
HALF_WINDOW_S = 0.25

# Where nothing was measured for longer than this, nothing is known of the time between.
GAP_S = 1.0

# What is shorter than this is no crossing, but noise: inside as well as outside.
BRIEF_S = 0.5

Values = NDArray[np.float64]

_at_s = attrgetter("at_s")


class Stay(Struct, frozen=True):
    """A time through which a target was where a condition holds.

    Attributes:
        is_entered: Whether the recording shows how it began; not where it was there from the first.
    """

    from_s: float
    to_s: float
    is_entered: bool


def stays(at_s: Sequence[float], distances_m: Sequence[float], condition: DistanceCondition) -> list[Stay]:
    """Return, in order, when a target was where a condition holds, regardless of hysteresis, delays and probability.

    Args:
        at_s: The times of the measurements, in order.
        distances_m: The distances, or depths; a NaN counts as not measured.
    """
    times, measured = np.asarray(at_s, float), np.asarray(distances_m, float)
    known = np.isfinite(measured)
    times, measured = times[known], measured[known]
    found: list[Stay] = []
    for part in np.split(np.arange(len(times)), np.flatnonzero(np.diff(times) > GAP_S) + 1):
        if len(part) > 1:
            found += _merge(_stays(times[part], _smooth(times[part], measured[part]), condition))
    return [stay for stay in found if stay.to_s - stay.from_s >= BRIEF_S]


def _smooth(at_s: Values, distances_m: Values) -> Values:
    """Return the mean around each moment; the window is as long before as after, so it shrinks at the ends."""
    half_s = np.minimum(HALF_WINDOW_S, np.minimum(at_s - at_s[0], at_s[-1] - at_s))
    begin = np.searchsorted(at_s, at_s - half_s - 1e-9, "left")
    end = np.searchsorted(at_s, at_s + half_s + 1e-9, "right")
    total = np.concatenate([[0.0], np.cumsum(distances_m)])
    mean: Values = (total[end] - total[begin]) / (end - begin)
    return mean


def _margins_m(distances_m: Values, condition: DistanceCondition) -> Values:
    """Return by how much the condition holds at each moment; below 0 it does not."""
    below_m = np.inf if condition.below is None else condition.below
    above_m = -np.inf if condition.above is None else condition.above
    margins: Values = np.minimum(below_m - distances_m, distances_m - above_m)
    return margins


def _stays(at_s: Values, distances_m: Values, condition: DistanceCondition) -> list[Stay]:
    margins_m = _margins_m(distances_m, condition)
    inside = margins_m > 0
    changes = np.flatnonzero(inside[1:] != inside[:-1])
    shares = margins_m[changes] / (margins_m[changes] - margins_m[changes + 1])
    crossed_s = at_s[changes] + shares * (at_s[changes + 1] - at_s[changes])
    bounds_s = [float(at_s[0])] * bool(inside[0]) + [float(time_s) for time_s in crossed_s]
    bounds_s += [float(at_s[-1])] * bool(inside[-1])
    return [
        Stay(from_s, to_s, is_entered=number > 0 or not inside[0])
        for number, (from_s, to_s) in enumerate(zip(bounds_s[::2], bounds_s[1::2], strict=True))
    ]


def _merge(found: Sequence[Stay]) -> list[Stay]:
    """Join stays with hardly any time between them."""
    joined: list[Stay] = []
    for stay in found:
        if joined and stay.from_s - joined[-1].to_s < BRIEF_S:
            joined[-1] = Stay(joined[-1].from_s, stay.to_s, joined[-1].is_entered)
        else:
            joined.append(stay)
    return joined


# An alarm that is raised at most this long before its distance was truly crossed was raised by that crossing.
EARLY_S = 0.5


class RuleFigures(Struct, frozen=True, kw_only=True):
    """Figures of one rule.

    Attributes:
        late_median_s: How long after its distance was crossed it was raised, the median; None if that is not known.
        unfounded: How often it was raised while its distance was not crossed; None if that is not known.
        least_distance_m: The least distance of what it watches while it was not active; None if it watches none.
    """

    rule: str
    raised: int
    transitions_per_minute: float
    late_median_s: float | None = None
    late_worst_s: float | None = None
    missed: int | None = None
    unfounded: int | None = None
    least_distance_m: float | None = None


class Tally(Struct):
    """Counts through a replay what its figures are made of."""

    plan: Plan
    events: list[Event] = field(default_factory=list)
    from_s: float | None = None
    to_s: float = 0.0
    _distances: tuple[tuple[int, str, str], ...] = ()
    _least_m: dict[str, float] = field(default_factory=dict)
    _measured: dict[str, tuple[list[float], list[float], list[float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Find the alarms on a distance, each with its place in the plan, its name and its target."""
        self._distances = tuple(
            (number, rule.name, leaf.target)
            for number, rule in enumerate(self.plan.rules)
            if isinstance(rule, AlarmRule)
            for leaf in leaves(rule.condition)
            if isinstance(leaf, DistanceCondition)
        )

    @property
    def minutes(self) -> float:
        """Length of the replay, in minutes."""
        return 0.0 if self.from_s is None else (self.to_s - self.from_s) / 60

    def add(self, observation: Observation, decision: Decision) -> None:
        """Add one cycle."""
        self.from_s = observation.now_s if self.from_s is None else self.from_s
        self.to_s = observation.now_s
        self.events += decision.events
        if observation.frame is not None:
            self._add_frame(observation, decision)

    def figures(self) -> tuple[RuleFigures, ...]:
        """Return the figures of each alarm, in the order of the plan. Other rules have no events."""
        return tuple(self._figures(rule) for rule in self.plan.rules if isinstance(rule, AlarmRule))

    def _add_frame(self, observation: Observation, decision: Decision) -> None:
        for measured in observation.measurements:
            if measured.distance_m is not None and measured.depth_m is not None:
                at_s, distances_m, depths_m = self._measured.setdefault(measured.target, ([], [], []))
                at_s.append(measured.captured_at_s)
                distances_m.append(measured.distance_m)
                depths_m.append(measured.depth_m)
        self.add_silence({track.target: track for track in decision.tracks}, decision.rules)

    def add_silence(self, tracks: Mapping[str, Track], rules: Sequence[RuleTrace]) -> None:
        """Add how near targets are in a frame while their rules are silent."""
        for number, name, target in self._distances:
            distance_m = tracks[target].distance_m if tracks[target].is_valid else None
            if distance_m is not None and rules[number].active is not True:
                self._least_m[name] = min(distance_m, self._least_m.get(name, math.inf))

    def with_rules(self, plan: Plan, others: Tally) -> Tally:
        """Return the tally of a plan of which some rules differ, and were judged apart: those of `others`."""
        judged_apart = {rule.name for rule in others.plan.rules}
        events = [event for event in self.events if event.source not in judged_apart]
        least_m = {name: each_m for name, each_m in self._least_m.items() if name not in judged_apart}
        return replace(
            self, plan=plan, events=sorted(events + others.events, key=_at_s), _least_m=least_m | others._least_m
        )

    def _figures(self, rule: AlarmRule) -> RuleFigures:
        raised_s = self._times_s(rule.name, {EventKind.RAISED})
        cleared_s = self._times_s(rule.name, {EventKind.CLEARED})
        where = _watched_distance(rule)
        late_s: list[float] = []
        missed = unfounded = None
        if where is not None and where.target in self._measured:
            at_s, distances_m, depths_m = self._measured[where.target]
            true = stays(at_s, depths_m if where.quantity == "depth" else distances_m, where)
            late_s, missed = _lateness(true, raised_s, cleared_s)
            unfounded = sum(
                not any(stay.from_s - EARLY_S <= time_s <= stay.to_s for stay in true) for time_s in raised_s
            )
        return RuleFigures(
            rule=rule.name,
            raised=len(raised_s),
            transitions_per_minute=(len(raised_s) + len(cleared_s)) / self.minutes if self.minutes else 0.0,
            late_median_s=median(late_s) if late_s else None,
            late_worst_s=max(late_s, default=None),
            missed=missed,
            unfounded=unfounded,
            least_distance_m=self._least_m.get(rule.name),
        )

    def _times_s(self, rule: str, kinds: Iterable[EventKind]) -> list[float]:
        return [event.at_s for event in self.events if event.source == rule and event.kind in kinds]


def _watched_distance(rule: AlarmRule) -> DistanceCondition | None:
    """Return the distance that an alarm watches; None if it watches something else, or more."""
    return rule.condition if isinstance(rule.condition, DistanceCondition) else None


def _lateness(true: Sequence[Stay], raised_s: Sequence[float], cleared_s: Sequence[float]) -> tuple[list[float], int]:
    """Return the delays with which crossings were noticed, and how many were not. Alarms that stood do not count."""
    late_s, missed = [], 0
    for stay in true:
        begin_s = stay.from_s - EARLY_S
        raised = next((time_s for time_s in raised_s if begin_s <= time_s <= stay.to_s), None)
        if raised is not None:
            late_s += [raised - stay.from_s] if stay.is_entered else []
        elif not _stood(begin_s, raised_s, cleared_s):
            missed += 1
    return late_s, missed


def _stood(at_s: float, raised_s: Sequence[float], cleared_s: Sequence[float]) -> bool:
    last_raised_s = max((time_s for time_s in raised_s if time_s < at_s), default=-math.inf)
    last_cleared_s = max((time_s for time_s in cleared_s if time_s < at_s), default=-math.inf)
    return last_raised_s > last_cleared_s
