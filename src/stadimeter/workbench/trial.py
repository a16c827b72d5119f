"""Trials: what a plan would have done on observations, as alarms, commands and figures.

`run` is the one way to find out: of a recording, a simulation or the input of a rule test. On it stand the tests of a
configuration, replays and their differences, a threshold that is dragged on the page, and `tune`.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.config.loader import Configuration
from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.decide import JudgedBy, State, decide, initial_state, judged_by
from stadimeter.core.decision import Decision, Event, EventKind, RuleTrace
from stadimeter.core.measurement import Track
from stadimeter.core.observation import Observation
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rule import AlarmRule, FollowRule, conditions_of
from stadimeter.core.rules.explaining import Reasons
from stadimeter.core.rules.scheduler import asks_for, judge, with_steps
from stadimeter.errors import JournalError
from stadimeter.workbench.replay import AnyRecording, ReplayRun, decisions, first_state

# From when to when, in seconds since the beginning.
Span = tuple[float, float]

# A time, a distance or None, and its standard deviation.
Point = tuple[float, float | None, float]

Floats = NDArray[np.float64]

_Columns = partial(msgspec.field, default_factory=lambda: defaultdict(lambda: (array("d"), array("d"), array("d"))))


class Trial(Struct, kw_only=True):
    """The deeds of a plan on observations.

    Attributes:
        began_s: The beginning of the recording, on the run's clock, by which events are stamped.
        from_s: The time of the first cycle since then, as all that is no event is stamped.
        seconds: The time of the last cycle.
        sent: The event of each message and notification, with the rule as its source.
        traces: What each rule did, where that changed, each with its time.
        commands: The commands of each output, where they changed.
        samples: The track of each target: times, distances (NaN for none), and standard deviations.
        measured: The measurements of each target: capture times, distances and depths.
    """

    plan: Plan
    began_s: float = math.nan
    from_s: float = 0.0
    seconds: float = 0.0
    cycles: int = 0
    events: list[Event] = msgspec.field(default_factory=list)
    sent: list[Event] = msgspec.field(default_factory=list)
    traces: defaultdict[str, list[tuple[float, RuleTrace]]] = msgspec.field(default_factory=lambda: defaultdict(list))
    commands: defaultdict[str, list[tuple[float, Command]]] = msgspec.field(default_factory=lambda: defaultdict(list))
    samples: Any = _Columns()
    measured: Any = _Columns()

    @property
    def minutes(self) -> float:
        """Its length."""
        return (self.seconds - self.from_s) / 60

    def add(self, observation: Observation, decision: Decision) -> None:
        """Add a cycle."""
        self.began_s = observation.now_s if math.isnan(self.began_s) else self.began_s
        self.seconds = at_s = observation.now_s - self.began_s
        self.cycles += 1
        self.sent += [replace(notice.event, source=notice.rule) for notice in decision.notices]
        self.add_rules(at_s, decision.rules, decision.events)
        for command in decision.commands:
            changes = self.commands[command.output]
            if not changes or command_figures(changes[-1][1]) != command_figures(command):
                changes.append((at_s, command))
        for track in decision.tracks:
            _append(self.samples[track.target], at_s, _distance_m(track), track.sigma_m or 0.0)
        for each in observation.measurements if observation.frame is not None else ():
            if each.distance_m is not None and each.depth_m is not None:
                _append(self.measured[each.target], each.captured_at_s, each.distance_m, each.depth_m)

    def add_rules(self, at_s: float, traces: Sequence[RuleTrace], events: Iterable[Event]) -> None:
        """Add what the rules did in a cycle."""
        self.seconds = at_s
        self.events += events
        for trace in traces:
            changes = self.traces[trace.rule]
            if not changes or (changes[-1][1] is not trace and changes[-1][1] != trace):
                changes.append((at_s, trace))

    def spans(self, rule: str) -> list[Span]:
        """Return when a rule was active, as spans that do not touch each other."""
        found: list[Span] = []
        changes = [(at_s, trace.active is True) for at_s, trace in self.traces.get(rule, ())]
        for (at_s, is_on), (end_s, _) in pairwise([*changes, (self.seconds, False)]):
            if is_on and found and found[-1][1] == at_s:
                found[-1] = found[-1][0], end_s
            elif is_on:
                found.append((at_s, end_s))
        return found

    def points(self, target: str) -> list[Point]:
        """Return the track of a target for a chart; see `thin_points`."""
        known = zip(*self.samples[target], strict=True)
        return thin_points([(at_s, None if math.isnan(at_m) else at_m, sigma_m) for at_s, at_m, sigma_m in known])

    def figures(self) -> tuple[RuleFigures, ...]:
        """Return the figures of each alarm, in the order of the plan. Other rules have no events."""
        return tuple(self._figures(rule) for rule in self.plan.rules if isinstance(rule, AlarmRule))

    def _figures(self, rule: AlarmRule) -> RuleFigures:
        raised_s = [each.at_s for each in self.events if each.source == rule.name and each.kind is EventKind.RAISED]
        condition = rule.condition
        late_s: list[float] = []
        missed = unfounded = None
        if isinstance(condition, DistanceCondition) and condition.target in self.measured:
            at_s, distances_m, depths_m = self.measured[condition.target]
            true = stays(at_s, depths_m if condition.quantity == "depth" else distances_m, condition.limits)
            missed, stood = 0, [(self.began_s + from_s, self.began_s + to_s) for from_s, to_s in self.spans(rule.name)]
            for stay in true:
                begin_s = stay.from_s - EARLY_S
                raised = next((each for each in raised_s if begin_s <= each <= stay.to_s), None)
                if raised is None:  # an alarm that stood before counts for neither
                    missed += not any(from_s < begin_s <= to_s for from_s, to_s in stood)
                elif stay.is_entered:
                    late_s.append(raised - stay.from_s)
            unfounded = sum(not any(each.from_s - EARLY_S <= at <= each.to_s for each in true) for at in raised_s)
        return RuleFigures(
            rule=rule.name,
            raised=len(raised_s),
            late_worst_s=max(late_s, default=None),
            missed=missed,
            unfounded=unfounded,
        )


def run(plan: Plan, observations: Iterable[Observation], *watches: Callable[[float, Decision], None]) -> Trial:
    """Find out what a plan would have done, from its beginning on; opens and moves nothing.

    Args:
        watches: Each takes the time since the first cycle, and the decision, in every cycle.
    """
    trial, state = Trial(plan=plan), initial_state(plan)
    for observation in observations:
        state, decision = decide(state, observation)
        trial.add(observation, decision)
        for watch in watches:
            watch(trial.seconds, decision)
    return trial


def command_figures(command: Command) -> tuple[float, ...]:
    """Return the level of a command; of a base's, the speeds forwards, of turning and of tilting."""
    if isinstance(command, LevelCommand):
        return (command.level,)
    return (command.linear_mps, command.angular_radps, command.tilt_radps)


def _append(columns: tuple[array[float], ...], *row: float) -> None:
    for column, value in zip(columns, row, strict=True):
        column.append(value)


def _distance_m(track: Track) -> float:
    return track.distance_m if track.is_valid and track.distance_m is not None else math.nan


# Figures of rules: how late they were, what they missed ---------------------------------------------------------------

# A figure is the mean of those measured within this before and after.
HALF_WINDOW_S = 0.25

# Where nothing was measured for longer than this, nothing is known of the time between.
GAP_S = 1.0

# What is shorter than this is no crossing, but noise: inside as well as outside.
BRIEF_S = 0.5

# An alarm that is raised at most this long before its distance was truly crossed was raised by that crossing.
EARLY_S = 0.5


class RuleFigures(Struct, frozen=True, kw_only=True):
    """Figures of one rule.

    Attributes:
        late_worst_s: How long after its distance was crossed it was raised, at most; None if that is not known.
        unfounded: How often it was raised while its distance was not crossed; None if that is not known.
    """

    rule: str
    raised: int
    late_worst_s: float | None = None
    missed: int | None = None
    unfounded: int | None = None


class Stay(Struct, frozen=True):
    """A time through which a target was where a condition holds.

    Attributes:
        is_entered: Whether the recording shows how it began; not where it was there from the first.
    """

    from_s: float
    to_s: float
    is_entered: bool


def stays(at_s: Sequence[float], figures: Sequence[float], limits: tuple[float, float]) -> list[Stay]:
    """Return, in order, when a figure was within limits, regardless of hysteresis, delays and probability.

    Args:
        at_s: The times of the measurements, in order.
        figures: Such as distances; a NaN counts as not measured.
    """
    times, measured = np.asarray(at_s, float), np.asarray(figures, float)
    known = np.isfinite(measured)
    times, measured = times[known], measured[known]
    found: list[Stay] = []
    for part in np.split(np.arange(len(times)), np.flatnonzero(np.diff(times) > GAP_S) + 1):
        if len(part) > 1:
            found += _merge(_stays(times[part], _smooth(times[part], measured[part]), limits))
    return [stay for stay in found if stay.to_s - stay.from_s >= BRIEF_S]


def _smooth(at_s: Floats, figures: Floats) -> Floats:
    """Return the mean around each moment; the window is as long before as after, so it shrinks at the ends."""
    half_s = np.minimum(HALF_WINDOW_S, np.minimum(at_s - at_s[0], at_s[-1] - at_s))
    begin = np.searchsorted(at_s, at_s - half_s - 1e-9, "left")
    end = np.searchsorted(at_s, at_s + half_s + 1e-9, "right")
    total = np.concatenate([[0.0], np.cumsum(figures)])
    mean: Floats = (total[end] - total[begin]) / (end - begin)
    return mean


def _stays(at_s: Floats, figures: Floats, limits: tuple[float, float]) -> list[Stay]:
    margins = np.minimum(limits[1] - figures, figures - limits[0])
    inside = margins > 0
    changes = np.flatnonzero(inside[1:] != inside[:-1])
    shares = margins[changes] / (margins[changes] - margins[changes + 1])
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


# Two trials of one recording, compared --------------------------------------------------------------------------------

# Two events of one kind and source that are further apart than this are different events.
SAME_WITHIN_S = 5.0

# Events that are nearer than this are at the same time.
MOVED_S = 1e-9


class EventChange(Struct, frozen=True, kw_only=True):
    """An event that is not the same with both sets of rules; it is of the new rules, unless it is lost.

    Attributes:
        by_s: The time by which it moved, positive for later; 0 if it did not move.
    """

    change: Literal["added", "lost", "moved"]
    event: Event
    by_s: float = 0.0


class RuleChange(Struct, frozen=True, kw_only=True):
    """The figures of a rule with both sets of rules; None where there is no such rule."""

    rule: str
    old: RuleFigures | None
    new: RuleFigures | None


class TrialDiff(Struct, frozen=True, kw_only=True):
    """The difference that new rules make: changed events in order of time, and the figures of each rule."""

    minutes: float
    same_events: int
    changes: tuple[EventChange, ...]
    rules: tuple[RuleChange, ...]

    def summary(self) -> str:
        """Say how many events are the same, and how many are not."""
        counts = {kind: sum(change.change == kind for change in self.changes) for kind in ("added", "lost", "moved")}
        counted = ", ".join(f"{count} {kind}" for kind, count in counts.items())
        return f"{self.same_events} events are the same, {counted}, in {self.minutes:.1f} minutes."


def compare(old: Trial, new: Trial) -> TrialDiff:
    """Compare two trials of one recording."""
    old_events, new_events = _by_subject(old.events), _by_subject(new.events)
    pairs = [
        pair
        for subject in {**old_events, **new_events}
        for pair in _pair_events(old_events[subject], new_events[subject])
    ]
    changes = sorted(
        (change for pair in pairs if (change := _change(*pair))),
        key=lambda change: (change.event.at_s, change.event.sequence, change.change),
    )
    before, after = ({each.rule: each for each in trial.figures()} for trial in (old, new))
    rules = tuple(RuleChange(rule=name, old=before.get(name), new=after.get(name)) for name in {**after, **before})
    return TrialDiff(minutes=new.minutes, same_events=len(pairs) - len(changes), changes=tuple(changes), rules=rules)


def _change(before: Event | None, after: Event | None) -> EventChange | None:
    if before is not None and after is not None:
        by_s = after.at_s - before.at_s
        return EventChange(change="moved", event=after, by_s=by_s) if abs(by_s) > MOVED_S else None
    if after is not None:
        return EventChange(change="added", event=after)
    return EventChange(change="lost", event=before) if before is not None else None


def _by_subject(events: Sequence[Event]) -> defaultdict[tuple[str, str], list[Event]]:
    found: defaultdict[tuple[str, str], list[Event]] = defaultdict(list)
    for event in events:
        found[event.kind.value, event.source].append(event)
    return found


def _pair_events(old: Sequence[Event], new: Sequence[Event]) -> list[tuple[Event | None, Event | None]]:
    """Pair events of one kind and source, in order of time: each with the nearest that is left for it."""
    # Both lists are sorted by time, so one pass does: the earlier of the two heads is paired, or is alone for good.
    pairs: list[tuple[Event | None, Event | None]] = []
    i = j = 0
    while i < len(old) and j < len(new):
        apart_s = new[j].at_s - old[i].at_s
        if abs(apart_s) <= SAME_WITHIN_S and not _has_nearer(old, new, i, j):
            pairs.append((old[i], new[j]))
            i, j = i + 1, j + 1
        elif apart_s > 0:
            pairs.append((old[i], None))
            i += 1
        else:
            pairs.append((None, new[j]))
            j += 1
    return [*pairs, *((event, None) for event in old[i:]), *((None, event) for event in new[j:])]


def _has_nearer(old: Sequence[Event], new: Sequence[Event], i: int, j: int) -> bool:
    """Check whether the later of two events is nearer to the one that follows the earlier."""
    apart_s = new[j].at_s - old[i].at_s
    if apart_s > 0:
        return i + 1 < len(old) and abs(new[j].at_s - old[i + 1].at_s) < apart_s
    return j + 1 < len(new) and abs(new[j + 1].at_s - old[i].at_s) < -apart_s


# Recordings that are gone through a part at a time, as a page asks for them -------------------------------------------

# A chart as wide as a screen has no more pixels.
POINTS_MAX = 1500

# Nearly four hours at 30 a second: what is gone through is kept, and a small Pi has little memory.
CYCLES_MAX = 400_000

# The cycles whose inputs are kept of all recordings together, times the targets: 20 minutes of one target at 30 a
# second. One takes 2.5 kB, as was measured once, so all take 90 MB; a Pi Zero 2 W has 512 MB.
KEPT_CYCLES_MAX = 36_000


class Passage(ABC):
    """A recording that is gone through a part at a time.

    Attributes:
        is_done: Whether that is to its end, or as far as there is room.
        damage: Why it cannot be read to its end; empty if it can.
    """

    is_done = False
    damage = ""
    _cycles: Iterator[None] | None = None

    def go_on(self, for_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Go on for this long, or to the end; damage ends it as well."""
        until_s = clock() + for_s
        self._cycles = self._through() if self._cycles is None else self._cycles
        while not self.is_done and clock() < until_s:
            try:
                self.is_done = next(self._cycles, self) is self
            except JournalError as error:
                self.damage, self.is_done = str(error), True

    @abstractmethod
    def _through(self) -> Iterator[None]:
        """Yield after each cycle."""


class SideBySide(Passage):
    """A recording with two configurations at once, each with its trial; the first may be that of the recording."""

    def __init__(self, before: ReplayRun, after: ReplayRun) -> None:
        self.before, self.after = before, after
        self.old, self.new = (Trial(plan=each.configuration.plan) for each in (before, after))
        self.targets: set[str] = set()

    def _through(self) -> Iterator[None]:
        for (_, observation, old), (_, _, new) in zip(self.before, self.after, strict=False):
            self.targets.update([measured.target for measured in observation.measurements])
            self.old.add(observation, old)
            self.new.add(observation, new)
            yield
            if self.new.cycles >= CYCLES_MAX:
                return


class KeptCycle(NamedTuple):
    """A cycle that rules can be judged in again."""

    at_s: float
    """Since the beginning of the recording."""
    by: JudgedBy


@dataclass(kw_only=True)
class KeptRecording(Passage):
    """A recording that is decided on by a configuration, with what its rules were judged by.

    What rules are judged by in a cycle (tracks, the frame, the time of day, commands of operators) does not depend on
    what they decide, unless a base is driven. So one changed rule is judged again on what was kept, and at once.

    Attributes:
        from_s: Cycles before this are passed over, and it begins with nothing known.
        cycles_max: No more cycles than this are taken.
        began_s: The time of the first cycle of the recording, on the run's clock.
    """

    recording: AnyRecording
    configuration: Configuration
    from_s: float = 0.0
    cycles_max: int = KEPT_CYCLES_MAX
    began_s: float = math.nan
    cycles: list[KeptCycle] = field(default_factory=list)
    trial: Trial = field(init=False)

    def __post_init__(self) -> None:
        self.trial = Trial(plan=self.configuration.plan, from_s=self.from_s)

    @property
    def seconds(self) -> float:
        """Up to where it is decided on."""
        return self.cycles[-1].at_s if self.cycles else 0.0

    def _through(self) -> Iterator[None]:
        state = self._first_state(self.configuration.plan)
        for cycle in self.recording.cycles():
            if len(self.cycles) >= self.cycles_max:
                return
            self.began_s = cycle.now_s() if math.isnan(self.began_s) else self.began_s
            if cycle.now_s() < self.began_s + self.from_s:
                continue
            observation = cycle.observation()
            after, decision = decide(state, observation)
            if not isinstance(decision.reasons, Reasons):
                raise TypeError("a decision without its reasons")
            by = judged_by(state, observation, decision.reasons.inputs, after.safety)
            self.cycles.append(KeptCycle(observation.now_s - self.began_s, by))
            self.trial.began_s = self.began_s
            self.trial.add(observation, decision)
            state = after
            yield

    def _first_state(self, plan: Plan) -> State:
        return initial_state(plan) if self.from_s else first_state(self.recording, plan)

    def with_plan(self, plan: Plan, name: str) -> Trial:
        """Find what an alarm would have done by another plan, which differs in nothing but that alarm."""
        alone = judged_apart(plan, name)
        if alone is None:
            trial = Trial(plan=plan, began_s=self.began_s, from_s=self.from_s)
            again = decisions(self.recording, plan, from_s=self.began_s + self.from_s if self.from_s else None)
            for _, (_, observation, decision) in zip(self.cycles, again, strict=False):
                trial.add(observation, decision)
            return trial
        some = replace(plan, rules=tuple(plan.rules[index] for index in alone))
        trial = Trial(plan=some, began_s=self.began_s, from_s=self.from_s, measured=self.trial.measured)
        names, first = {rule.name for rule in some.rules}, self._first_state(plan).rules
        rules = with_steps(some, tuple(first.steps[index] for index in alone), first.first_out, first.raised_at_s)
        for at_s, by in self.cycles:
            commands = tuple([each for each in by.commands if each.rule in names or not each.rule])
            rules, outcome = judge(rules, by.inputs, by.sample, by.cycle, commands)
            trial.add_rules(at_s, rules.traces, outcome.events)
        return trial


def judged_apart(plan: Plan, name: str) -> tuple[int, ...] | None:
    """Return the positions of the rules with which an alarm is judged apart from all else; None where it cannot be.

    They are itself, those that it asks for and those of its group, and so on. It is not certain to be the same if a
    remembered figure sums up what a rule does; or if one drives a base, or counts targets, which stops while the
    picture does not show that a base moves.
    """
    asked = {rule.name: asks_for(rule) for rule in plan.rules}
    groups = {rule.name: rule.group for rule in plan.rules if isinstance(rule, AlarmRule) and rule.group}
    names = {name}
    while more := {
        each
        for each in asked
        if each not in names
        and (any(each in asked[other] for other in names) or groups.get(each) in {groups.get(o, "") for o in names})
    }:
        names |= more
    found = tuple(index for index, rule in enumerate(plan.rules) if rule.name in names)
    rules = [plan.rules[each] for each in found]
    has_base = any(isinstance(output, BaseOutput) for output in plan.outputs)
    counts = any(
        isinstance(leaf, CountCondition)
        for each in rules
        for condition in conditions_of(each)
        for leaf in leaves(condition)
    )
    is_summed = any(names.intersection(figure.rules) for figure in plan.figures)
    if is_summed or any(isinstance(each, FollowRule) for each in rules) or (has_base and counts):
        return None
    return found


def thin_points(points: list[Point]) -> list[Point]:
    """Return no more than `POINTS_MAX` of them, with the lowest and the highest of each short span, and each gap."""
    if len(points) <= POINTS_MAX:
        return points
    size = math.ceil(len(points) / (POINTS_MAX // 3))
    found: list[Point] = []
    for begin in range(0, len(points), size):
        span = sorted(points[begin : begin + size], key=lambda point: math.inf if point[1] is None else point[1])
        known = [each for each in span if each[1] is not None]
        found += sorted({*known[:1], *known[-1:], *span[len(known) : len(known) + 1]})
    return found
