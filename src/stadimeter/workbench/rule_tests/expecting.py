"""From what a test expects of a rule or an output to the watches that look for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from stadimeter.config.rule_test_tables import ExpectTable, PathPoint, SpanTable
from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.condition import DistanceCondition
from stadimeter.core.conditions import verdict as conditions
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.decision import Event, EventKind, RuleStatus, RuleTrace
from stadimeter.core.outputs import safe_command
from stadimeter.core.plan import Output, Plan
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.rules.explaining import explain
from stadimeter.core.track import Track
from stadimeter.workbench.rule_tests.synthetic_track import position_at
from stadimeter.workbench.rule_tests.watching import (
    AlwaysWatch,
    CountWatch,
    DecidedCycle,
    EndWatch,
    FirstWatch,
    MomentWatch,
    PeakWatch,
    WatchedItem,
    Watcher,
    WithinWatch,
)

_TRANSITIONS = frozenset({EventKind.RAISED, EventKind.CLEARED})
_TOLD_OF = frozenset({EventKind.RAISED, EventKind.CLEARED, EventKind.REALARMED})


def watches(name: str, expected: ExpectTable, plan: Plan, path: Sequence[PathPoint]) -> Iterator[Watcher]:
    """Return what looks for everything that is expected of a rule or output.

    Args:
        name: Its name. A rule and an output may share one.
        path: Where the rule's target truly is when; empty where that is not known.
    """
    for index, rule in enumerate(plan.rules):
        if rule.name == name:
            yield from _RuleWatches(rule, index, expected, path).all()
    for index, output in enumerate(plan.outputs):
        if output.name == name:
            yield from _OutputWatches(output, index, expected).all()


@dataclass(frozen=True, slots=True)
class _RuleWatches:
    """Makes the watches of one rule."""

    rule: AnyRule
    index: int
    expected: ExpectTable
    path: Sequence[PathPoint]

    def all(self) -> Iterator[Watcher]:
        yield from self._counts()
        yield from self._firsts()
        yield from self._moments()
        yield from self._ends()

    def _trace(self, cycle: DecidedCycle) -> RuleTrace:
        return cycle.decision.rules[self.index]

    def _is_active(self, cycle: DecidedCycle) -> bool:
        return self._trace(cycle).active is True

    def _doing(self, cycle: DecidedCycle) -> str:
        return explain(cycle.decision, self.rule.name).sentence

    def _about(self, key: str) -> WatchedItem:
        return WatchedItem(name=self.rule.name, key=key, doing=self._doing)

    def _events(self, kinds: frozenset[EventKind]) -> Callable[[DecidedCycle], list[Event]]:
        name = self.rule.name
        return lambda cycle: [event for event in cycle.decision.events if event.source == name and event.kind in kinds]

    def _notified_events(self, cycle: DecidedCycle) -> list[Event]:
        return [event for event in self._events(_TOLD_OF)(cycle) if event.notify]

    def _sent_events(self, cycle: DecidedCycle) -> list[Event]:
        return [notice.event for notice in cycle.decision.notices if notice.rule == self.rule.name]

    def _counts(self) -> Iterator[Watcher]:
        expected = self.expected
        raised, cleared = self._events(frozenset({EventKind.RAISED})), self._events(frozenset({EventKind.CLEARED}))
        yield from self._exactly("raised", expected.raised, raised, ("raise", "raises"))
        yield from self._exactly("cleared", expected.cleared, cleared, ("clearing", "clearings"))
        yield from self._exactly(
            "notified", expected.notified, self._notified_events, ("notification", "notifications")
        )
        yield from self._exactly("sent", expected.sent, self._sent_events, ("message", "messages"))
        transitions, noun = self._events(_TRANSITIONS), ("transition", "transitions")
        if (most := expected.transitions_max) is not None:
            yield self._count("transitions_max", transitions, lambda _: (0, most), noun)
        if (rate := expected.transitions_per_min_max) is not None:
            yield self._count("transitions_per_min_max", transitions, lambda took_s: (0, rate * took_s / 60), noun)

    def _exactly(
        self, key: str, count: int | None, counted: Callable[[DecidedCycle], list[Event]], noun: tuple[str, str]
    ) -> Iterator[Watcher]:
        if count is not None:
            yield self._count(key, counted, lambda _: (count, count), noun)

    def _count(
        self,
        key: str,
        counted: Callable[[DecidedCycle], Iterable[Event]],
        limits: Callable[[float], tuple[float, float]],
        noun: tuple[str, str],
    ) -> Watcher:
        near = RuleStatus.CLEARING if key == "cleared" else RuleStatus.PENDING
        return CountWatch(self._about(key), counted, limits, noun, lambda cycle: self._trace(cycle).status is near)

    def _firsts(self) -> Iterator[Watcher]:
        for kind in (EventKind.RAISED, EventKind.CLEARED):
            verb = kind.value
            by_s, after_s, within_s = (getattr(self.expected, f"{verb}_{key}") for key in ("by", "after", "within"))
            if by_s is not None:
                yield self._first(kind, f"{verb}_by", (0.0, by_s), f"{verb} by {by_s:.2f} s")
            if after_s is not None:
                words = f"{verb} not before {after_s:.2f} s"
                yield self._first(kind, f"{verb}_after", (after_s, math.inf), words)
            if within_s is not None:
                yield self._within(kind, f"{verb}_within", within_s)

    def _first(self, kind: EventKind, key: str, stretch_s: tuple[float, float], words: str) -> Watcher:
        return FirstWatch(self._about(key), self._events(frozenset({kind})), kind.value, stretch_s, words)

    def _within(self, kind: EventKind, key: str, within_s: float) -> Watcher:
        if not (isinstance(self.rule, AlarmRule) and isinstance(self.rule.condition, DistanceCondition)):
            raise TypeError(f"the rule {self.rule.name} has no limit on the distance alone")  # checked before
        limits = " and ".join(
            f"{each:.2f} m" for each in (self.rule.condition.above_m, self.rule.condition.below_m) if each
        )
        truth = _Truth(self.rule.condition, self.path)
        is_met = truth.begins if kind is EventKind.RAISED else truth.ends
        words = f"{'begins to hold' if kind is EventKind.RAISED else 'ends'} ({limits})"
        return WithinWatch(self._about(key), self._events(frozenset({kind})), kind.value, within_s, is_met, words)

    def _moments(self) -> Iterator[Watcher]:
        if (moments := self.expected.active_at) is not None:
            yield MomentWatch(self._about("active_at"), [(at, "active", self._is_active) for at in moments])
        if (moments := self.expected.inactive_at) is not None:
            inactive = [(at, "not active", lambda cycle: not self._is_active(cycle)) for at in moments]
            yield MomentWatch(self._about("inactive_at"), inactive)

    def _ends(self) -> Iterator[Watcher]:
        if (status := self.expected.status) is not None:
            yield EndWatch(
                self._about("status"),
                status.value,
                lambda cycle: self._trace(cycle).status is status,
                lambda cycle: self._trace(cycle).status.value,
            )
        if (acknowledged := self.expected.acknowledged) is not None:
            yield EndWatch(
                self._about("acknowledged"),
                _acknowledged_words(is_so=acknowledged),
                lambda cycle: self._trace(cycle).acknowledged is acknowledged,
                lambda cycle: _acknowledged_words(is_so=self._trace(cycle).acknowledged),
            )


class _Truth:
    """Judges the condition of a rule by where its target truly is, with the standard deviation that the track states.

    From then on the rule could know: what is later than that is late. A truth that is within the limit by less than the
    standard deviation asks for is none that a rule could act on.
    """

    def __init__(self, condition: DistanceCondition, path: Sequence[PathPoint]) -> None:
        self._condition = condition
        self._path = path
        self._before: Track | None = None
        self._has_begun = False

    def begins(self, cycle: DecidedCycle) -> bool:
        """Return whether the condition begins to hold. Shown every cycle, since a target may pass through a band."""
        return self._holds(cycle, is_on=False)

    def ends(self, cycle: DecidedCycle) -> bool:
        """Return whether the condition ends, having held."""
        if not self._has_begun:
            self._has_begun = self._holds(cycle, is_on=False)
            return False
        return not self._holds(cycle, is_on=True)

    def _holds(self, cycle: DecidedCycle, *, is_on: bool) -> bool:
        target = self._condition.target
        track = next(track for track in cycle.decision.tracks if track.target == target)
        if not self._path or not track.is_valid:
            return is_on
        true = position_at(self._path, cycle.at_s)
        depth_m = true.distance_m * math.cos(true.bearing_rad) * math.cos(true.elevation_rad)
        track = replace(track, distance_m=true.distance_m, depth_m=depth_m)
        before = {} if self._before is None else {target: self._before}
        self._before = track
        inputs = RuleInputs(tracks={target: track}, now_s=cycle.at_s, before=before)
        return conditions.judge(self._condition, inputs, (), is_active=is_on).value is True


def _acknowledged_words(*, is_so: bool) -> str:
    return "acknowledged" if is_so else "not acknowledged"


@dataclass(frozen=True, slots=True)
class _OutputWatches:
    """Makes the watches of one output."""

    output: Output
    index: int
    expected: ExpectTable

    def all(self) -> Iterator[Watcher]:
        yield from self._levels()
        yield from self._speeds()
        yield from self._moments()

    def _command(self, cycle: DecidedCycle) -> Command:
        return cycle.decision.commands[self.index]

    def _level(self, cycle: DecidedCycle) -> float:
        command = self._command(cycle)
        return command.level if isinstance(command, LevelCommand) else 0.0

    def _speed_mps(self, cycle: DecidedCycle) -> float:
        command = self._command(cycle)
        return 0.0 if isinstance(command, LevelCommand) else abs(command.linear_mps)

    def _is_stopped(self, cycle: DecidedCycle) -> bool:
        command, safe = self._command(cycle), safe_command(self.output)
        if isinstance(command, LevelCommand):
            return isinstance(safe, LevelCommand) and command.level == safe.level
        return (command.linear_mps, command.angular_radps) == (0.0, 0.0)

    def _doing(self, cycle: DecidedCycle) -> str:
        command, trace = self._command(cycle), cycle.decision.outputs[self.index]
        if isinstance(command, LevelCommand):
            does = f"level {command.level:.2f}"
        else:
            does = f"{command.linear_mps:.2f} m/s, {math.degrees(command.angular_radps):.0f} deg/s"
        why = trace.reason or cycle.decision.reasons.get(trace.winner, "")
        return f"{does}, commanded by {trace.winner}: {why}"

    def _about(self, key: str) -> WatchedItem:
        return WatchedItem(name=self.output.name, key=key, doing=self._doing)

    def _levels(self) -> Iterator[Watcher]:
        if (tables := self.expected.level_at) is not None:
            yield MomentWatch(self._about("level_at"), [self._level_at(table.at, *table.limits) for table in tables])
        if (most := self.expected.level_max) is not None:
            yield AlwaysWatch(
                self._about("level_max"),
                f"never above level {most:.2f}",
                lambda cycle: self._level(cycle) <= most,
                lambda cycle: f"level {self._level(cycle):.2f}",
            )
        if (least := self.expected.level_reaches) is not None:
            yield PeakWatch(self._about("level_reaches"), least, self._level)

    def _level_at(
        self, at_s: float, low: float, high: float
    ) -> tuple[float | SpanTable, str, Callable[[DecidedCycle], bool]]:
        words = f"level from {max(0.0, low):.2f} to {min(1.0, high):.2f}"
        return at_s, words, lambda cycle: low <= self._level(cycle) <= high

    def _speeds(self) -> Iterator[Watcher]:
        if (most_mps := self.expected.speed_max) is not None:
            yield AlwaysWatch(
                self._about("speed_max"),
                f"never faster than {most_mps:.2f} m/s",
                lambda cycle: self._speed_mps(cycle) <= most_mps,
                lambda cycle: f"{self._speed_mps(cycle):.2f} m/s",
            )
        if (least_mps := self.expected.speed_reaches) is not None:
            yield PeakWatch(self._about("speed_reaches"), least_mps, self._speed_mps, " m/s")

    def _moments(self) -> Iterator[Watcher]:
        if (moments := self.expected.stopped_at) is not None:
            yield MomentWatch(
                self._about("stopped_at"), [(at, "at its safe value", self._is_stopped) for at in moments]
            )
        if (moments := self.expected.acts_at) is not None:
            acts = [(at, "not at its safe value", lambda cycle: not self._is_stopped(cycle)) for at in moments]
            yield MomentWatch(self._about("acts_at"), acts)
