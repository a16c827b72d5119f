"""Running the tests of a configuration: its rules over synthetic or recorded observations. Opens and moves nothing."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.config.loader import Configuration
from stadimeter.config.rule_test_tables import ExpectTable, PathPoint, RuleTest, SpanTable
from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.conditions.compounds import judge
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision, Event, EventKind, RuleStatus, RuleTrace
from stadimeter.core.measurement import Track
from stadimeter.core.outputs import safe_command
from stadimeter.core.plan import Output, Plan
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.rules.explaining import explain
from stadimeter.errors import ConfigError, Problem, StadimeterError
from stadimeter.workbench.rule_tests.inputs import observations, position_at

# Watching one expectation of a test while it runs ---------------------------------------------------------------------
#
# A watch sees every cycle once and keeps only what its report needs: what was expected, what came instead, when,
# and the rule's reason at that moment. So a test over an hour of recording needs little memory.

SHOWN_EVENTS = 5
_ROUNDING_S = 1e-9


class DecidedCycle(Struct, frozen=True, kw_only=True):
    """One cycle of a test.

    Attributes:
        at_s: When, in seconds from the start of the test.
        start_s: The start of the test, on the clock that events are stamped with.
    """

    at_s: float
    start_s: float
    decision: Decision


class Failure(Struct, frozen=True, kw_only=True):
    """An expectation that was not met.

    Attributes:
        at_s: The moment that `why` is about, in seconds from the start of the test.
        why: What the rule or output was doing at that moment, and its reason.
    """

    subject: str
    key: str
    expected: str
    got: str
    at_s: float | None = None
    why: str = ""


IsMet = Callable[[DecidedCycle], bool]
InWords = Callable[[DecidedCycle], str]
FindEvents = Callable[[DecidedCycle], list[Event]]


class WatchedItem(Struct, frozen=True):
    """The subject of an expectation: a key of a rule or an output, and what that does in a cycle and why, in words."""

    name: str
    key: str
    describe: InWords

    def failure(self, expected: str, got: str, cycle: DecidedCycle | None = None) -> Failure:
        """Return a failure of it, at a cycle if there is one."""
        at_s, why = (None, "") if cycle is None else (cycle.at_s, self.describe(cycle))
        return Failure(subject=self.name, key=self.key, expected=expected, got=got, at_s=at_s, why=why)


class RuleTestWatch(ABC):
    """Watches one expectation."""

    @abstractmethod
    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""

    @abstractmethod
    def failures(self) -> Iterator[Failure]:
        """Yield what was not met, after the last cycle."""


@dataclass(eq=False)
class StateWatch(RuleTestWatch):
    """Expects something throughout a stretch of time, or at a moment. A cycle is current until the next one.

    Attributes:
        got: Says what is so in a cycle in which it is not met.
    """

    item: WatchedItem
    expected: str
    is_met: IsMet
    got: InWords
    start_s: float = -math.inf
    end_s: float = math.inf
    _cycle: DecidedCycle | None = field(default=None, init=False)
    _broken: DecidedCycle | None = field(default=None, init=False)

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        self._judge(cycle.at_s)
        self._cycle = cycle

    def failures(self) -> Iterator[Failure]:
        """Yield the first cycle in which it was not met, or that the test was over before."""
        last_s = self._cycle.at_s if self._cycle else 0.0
        self._judge(last_s + 2 * _ROUNDING_S)
        if self._broken is not None:
            got = f"{self.got(self._broken)} at {self._broken.at_s:.2f} s"
            yield self.item.failure(self.expected, got, self._broken)
        elif last_s + _ROUNDING_S < self.end_s < math.inf:
            yield self.item.failure(self.expected, f"the test was over at {last_s:.2f} s", self._cycle)

    def _judge(self, next_s: float) -> None:
        cycle, start_s = self._cycle, self.start_s + _ROUNDING_S
        if cycle is None or self._broken is not None or next_s <= start_s:
            return
        if cycle.at_s <= max(start_s, self.end_s - _ROUNDING_S) and not self.is_met(cycle):
            self._broken = cycle


class EndWatch(StateWatch):
    """Expects something in the last cycle."""

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        self._cycle = cycle


@dataclass(eq=False)
class PeakWatch(RuleTestWatch):
    """Expects a figure to be reached at some time."""

    item: WatchedItem
    least: float
    figure: Callable[[DecidedCycle], float]
    _peak: tuple[float, DecidedCycle] | None = field(default=None, init=False)

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        figure = self.figure(cycle)
        if self._peak is None or figure > self._peak[0]:
            self._peak = figure, cycle

    def failures(self) -> Iterator[Failure]:
        """Yield the highest figure if it is too low."""
        if self._peak is not None and self._peak[0] < self.least - _ROUNDING_S:
            peak, cycle = self._peak
            yield self.item.failure(f"{self.least:.2f} reached", f"{peak:.2f} at most, at {cycle.at_s:.2f} s", cycle)


@dataclass(eq=False)
class CountWatch(RuleTestWatch):
    """Expects a number of events.

    Attributes:
        noun: What is counted; its plural has an s.
        most: The greatest number that will do.
        is_near: Whether a cycle came near to such an event, for saying why there was not one more.
    """

    item: WatchedItem
    find: FindEvents
    noun: str
    is_near: IsMet
    least: float
    most: float
    _count: int = field(default=0, init=False)
    _shown: list[tuple[float, str]] = field(default_factory=list, init=False)
    _near: DecidedCycle | None = field(default=None, init=False)
    _cycle: DecidedCycle | None = field(default=None, init=False)

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        if self.is_near(cycle):
            self._near = cycle
        for event in self.find(cycle):
            self._count += 1
            self._near = None
            if len(self._shown) < SHOWN_EVENTS:
                self._shown.append((event.at_s - cycle.start_s, f"{event.kind.value}: {event.reason}"))
        self._cycle = cycle

    def failures(self) -> Iterator[Failure]:
        """Yield the count if it is wrong, with the first event too many, or the moment that came nearest."""
        if self.least <= self._count <= self.most:
            return
        expected = self._words(self.most) if self.least == self.most else f"{self._words(self.most)} at most"
        more = ", …" if self._count > len(self._shown) else ""
        times = f" (at {', '.join(f'{at_s:.2f} s' for at_s, _ in self._shown)}{more})" if self._shown else ""
        got = self._words(self._count) + times
        if self._count < self.least:
            yield self.item.failure(expected, got, self._near or self._cycle)
            return
        at_s, why = self._shown[min(int(self.most), len(self._shown) - 1)]
        yield replace(self.item.failure(expected, got), at_s=at_s, why=why)

    def _words(self, count: float) -> str:
        return f"{count:g} {self.noun}{'' if count == 1 else 's'}"


@dataclass(eq=False)
class FirstWatch(RuleTestWatch):
    """Expects the first event of a kind within a stretch of time; `verb` is what happens, such as ``raised``."""

    item: WatchedItem
    find: FindEvents
    verb: str
    expected: str
    not_before_s: float = 0.0
    by_s: float = math.inf
    _first: tuple[float, DecidedCycle] | None = field(default=None, init=False)
    _at_limit: DecidedCycle | None = field(default=None, init=False)

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        if self._first is None:
            event = next(iter(self.find(cycle)), None)
            self._first = (event.at_s - cycle.start_s, cycle) if event else None
        if cycle.at_s <= self.by_s + _ROUNDING_S:
            self._at_limit = cycle

    def failures(self) -> Iterator[Failure]:
        """Yield when it happened, if that is not within the stretch; and what was so at its end."""
        if self._first is None:
            yield self.item.failure(self.expected, f"never {self.verb}", self._at_limit)
            return
        at_s, cycle = self._first
        got = f"{self.verb} at {at_s:.2f} s"
        if at_s < self.not_before_s - _ROUNDING_S:
            yield self.item.failure(self.expected, got, cycle)
        elif at_s > self.by_s + _ROUNDING_S:
            yield self.item.failure(self.expected, f"{got}, {at_s - self.by_s:.2f} s late", self._at_limit)


@dataclass(eq=False, kw_only=True)
class WithinWatch(FirstWatch):
    """Expects the first event of a kind soon after a condition is met.

    Attributes:
        expected: What the condition does, in words.
        is_met: Whether the condition is met in a cycle; called in every cycle until it is.
    """

    within_s: float
    is_met: IsMet
    _has_begun: bool = field(default=False, init=False)

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        if not self._has_begun and self.is_met(cycle):
            self._has_begun = True
            self.by_s = cycle.at_s + self.within_s
            when = f"{cycle.at_s:.2f} s, where {self.expected}"
            self.expected = f"{self.verb} within {self.within_s:.2f} s of {when}"
        super().see(cycle)

    def failures(self) -> Iterator[Failure]:
        """Yield when it happened, if that is too late, or that it never had to happen."""
        return super().failures() if self._has_begun else iter([self.item.failure(self.expected, "it never does")])


class RuleTestResult(Struct, frozen=True, kw_only=True):
    """The result of one test.

    Attributes:
        failures: What was not met; none if it passed.
        events: What happened, with times from the start of the test.
        took_s: How long it was, in seconds of the test.
        trouble: Why it could not be run to its end; empty if it was.
    """

    test: RuleTest
    failures: tuple[Failure, ...] = ()
    events: tuple[tuple[float, Event], ...] = ()
    took_s: float = 0.0
    cycles: int = 0
    trouble: str = ""

    @property
    def passed(self) -> bool:
        """True if everything was as expected."""
        return not self.failures and not self.trouble


def run_rule_test(configuration: Configuration, test: RuleTest) -> RuleTestResult:
    """Run one test; a recording that cannot be read, or a target of unknown size, is trouble. Deterministic."""
    try:
        return _run(configuration, test)
    except ConfigError as error:
        return RuleTestResult(test=test, trouble="; ".join(_words(problem) for problem in error.problems))
    except StadimeterError as error:
        return RuleTestResult(test=test, trouble=str(error))


def _words(problem: Problem) -> str:
    return f"{problem.key}: {problem.message}" if problem.key else problem.message


def _run(configuration: Configuration, test: RuleTest) -> RuleTestResult:
    plan, watches = configuration.plan, list(_build_watches(test, configuration.plan))
    state, start_s, at_s = initial_state(plan), None, 0.0
    events: list[tuple[float, Event]] = []
    cycles = 0
    for observation in observations(test.input, configuration):
        state, decision = decide(state, observation)
        start_s = observation.now_s if start_s is None else start_s
        at_s = observation.now_s - start_s
        cycle = DecidedCycle(at_s=at_s, start_s=start_s, decision=decision)
        events += [(event.at_s - start_s, event) for event in decision.events]
        for watch in watches:
            watch.see(cycle)
        cycles += 1
    return RuleTestResult(
        test=test,
        failures=tuple(failure for watch in watches for failure in watch.failures()),
        events=tuple(events),
        took_s=at_s,
        cycles=cycles,
    )


def _build_watches(test: RuleTest, plan: Plan) -> Iterator[RuleTestWatch]:
    """Yield what looks for everything that is expected. A rule and an output may share a name."""
    motions = {} if test.input.journal is not None else test.input.motions(plan.targets)
    paths = {target: motion.path() for target, motion in motions.items()}
    for which in plan.nearest:  # of several that move, none is the nearest throughout
        moved = [paths[member] for member in which.members if member in paths]
        paths[which.name] = moved[0] if len(moved) == 1 else ()
    for name, expected in test.expect.items():
        for index, rule in enumerate(plan.rules):
            if rule.name == name:
                yield from _RuleWatches(rule, index, expected, paths.get(rule.target, ())).all()
        for index, output in enumerate(plan.outputs):
            if output.name == name:
                yield from _OutputWatches(output, index, expected).all()


def _watch_moments(
    item: WatchedItem, moments: Sequence[float | SpanTable] | None, words: str, is_met: IsMet, got: InWords
) -> Iterator[RuleTestWatch]:
    for moment in moments or ():
        if isinstance(moment, SpanTable):
            when = f"from {moment.start:.2f} s to {moment.end_s:.2f} s"
            yield StateWatch(item, f"{words} {when}", is_met, got, moment.start, moment.end_s)
        else:
            yield StateWatch(item, f"{words} at {moment:.2f} s", is_met, got, moment, moment)


class _RuleWatches(Struct, frozen=True):
    """Makes the watches of one rule.

    Attributes:
        path: Where the rule's target truly is when; empty where that is not known.
    """

    rule: AnyRule
    index: int
    expected: ExpectTable
    path: Sequence[PathPoint]

    def all(self) -> Iterator[RuleTestWatch]:
        """Yield a watch for each key that is given."""
        expected = self.expected
        yield from self._counts()
        for kind in (EventKind.RAISED, EventKind.CLEARED):
            yield from self._firsts(kind)
        active, inactive = self._item("active_at"), self._item("inactive_at")
        yield from _watch_moments(active, expected.active_at, "active", self._is_active, self._status)
        yield from _watch_moments(inactive, expected.inactive_at, "not active", self._is_inactive, self._status)
        if expected.status is not None:
            yield self._end("status", expected.status.value, self._status)
        if expected.acknowledged is not None:
            words = {True: "acknowledged", False: "not acknowledged"}
            wanted = words[expected.acknowledged]
            yield self._end("acknowledged", wanted, lambda cycle: words[self._trace(cycle).acknowledged])

    def _trace(self, cycle: DecidedCycle) -> RuleTrace:
        return cycle.decision.rules[self.index]

    def _is_active(self, cycle: DecidedCycle) -> bool:
        return self._trace(cycle).active is True

    def _is_inactive(self, cycle: DecidedCycle) -> bool:
        return not self._is_active(cycle)

    def _status(self, cycle: DecidedCycle) -> str:
        return self._trace(cycle).status.value

    def _describe(self, cycle: DecidedCycle) -> str:
        return explain(cycle.decision, self.rule.name).sentence

    def _item(self, key: str) -> WatchedItem:
        return WatchedItem(self.rule.name, key, self._describe)

    def _events(self, *kinds: EventKind) -> FindEvents:
        name = self.rule.name
        return lambda cycle: [event for event in cycle.decision.events if event.source == name and event.kind in kinds]

    def _find_sent(self, cycle: DecidedCycle) -> list[Event]:
        return [notice.event for notice in cycle.decision.notices if notice.rule == self.rule.name]

    def _counts(self) -> Iterator[RuleTestWatch]:
        transitions = self._events(EventKind.RAISED, EventKind.CLEARED)
        counted = (
            ("raised", self._events(EventKind.RAISED), "raise"),
            ("cleared", self._events(EventKind.CLEARED), "clearing"),
            ("sent", self._find_sent, "message"),
            ("transitions_max", transitions, "transition"),
        )
        for key, find, noun in counted:
            count: float | None = getattr(self.expected, key)
            if count is not None:
                near = RuleStatus.CLEARING if key == "cleared" else RuleStatus.PENDING
                least = 0 if key.endswith("_max") else count
                yield CountWatch(self._item(key), find, noun, self._is_in(near), least, count)

    def _is_in(self, status: RuleStatus) -> IsMet:
        return lambda cycle: self._trace(cycle).status is status

    def _firsts(self, kind: EventKind) -> Iterator[RuleTestWatch]:
        verb, find = kind.value, self._events(kind)
        by_s, after_s, within_s = (getattr(self.expected, f"{verb}_{key}") for key in ("by", "after", "within"))
        if by_s is not None:
            yield FirstWatch(self._item(f"{verb}_by"), find, verb, f"{verb} by {by_s:.2f} s", by_s=by_s)
        if after_s is not None:
            words = f"{verb} not before {after_s:.2f} s"
            yield FirstWatch(self._item(f"{verb}_after"), find, verb, words, not_before_s=after_s)
        if within_s is not None:
            if not (isinstance(self.rule, AlarmRule) and isinstance(self.rule.condition, DistanceCondition)):
                raise TypeError(f"the rule {self.rule.name} has no limit on the distance alone")  # checked before
            bounds = (self.rule.condition.above, self.rule.condition.below)
            limits = " and ".join(f"{each:.2f} m" for each in bounds if each)
            truth = _Truth(self.rule.condition, self.path)
            is_raised = kind is EventKind.RAISED
            words = f"its condition truly {'begins to hold' if is_raised else 'ends'} ({limits})"
            is_met = truth.begins if is_raised else truth.ends
            item = self._item(f"{verb}_within")
            yield WithinWatch(item, find, verb, words, within_s=within_s, is_met=is_met)

    def _end(self, key: str, wanted: str, words: InWords) -> RuleTestWatch:
        return EndWatch(self._item(key), f"{wanted} at the end", lambda cycle: words(cycle) == wanted, words)


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
        """Check whether the condition begins to hold. Shown every cycle, since a target may pass through a band."""
        return self._holds(cycle, is_on=False)

    def ends(self, cycle: DecidedCycle) -> bool:
        """Check whether the condition ends, having held."""
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
        return judge(self._condition, inputs, (), is_active=is_on).value is True


class _OutputWatches(Struct, frozen=True):
    """Makes the watches of one output."""

    output: Output
    index: int
    expected: ExpectTable

    def all(self) -> Iterator[RuleTestWatch]:
        """Yield a watch for each key that is given."""
        expected = self.expected
        for table in expected.level_at or ():
            low, high = table.limits
            words = f"level from {max(0.0, low):.2f} to {min(1.0, high):.2f}"
            is_met = partial(self._is_within, low, high)
            yield from _watch_moments(self._item("level_at"), [table.at], words, is_met, self._does)
        if (most := expected.level_max) is not None:
            yield self._never_above("level_max", most, self._level, f"never above level {most:.2f}")
        if expected.level_reaches is not None:
            yield PeakWatch(self._item("level_reaches"), expected.level_reaches, self._level)
        if (most := expected.speed_max) is not None:
            yield self._never_above("speed_max", most, self._speed_mps, f"never faster than {most:.2f} m/s")
        stopped, acting = self._item("stopped_at"), self._item("acts_at")
        yield from _watch_moments(stopped, expected.stopped_at, "at its safe value", self._is_stopped, self._does)
        yield from _watch_moments(acting, expected.acts_at, "not at its safe value", self._is_acting, self._does)

    def _command(self, cycle: DecidedCycle) -> Command:
        return cycle.decision.commands[self.index]

    def _level(self, cycle: DecidedCycle) -> float:
        command = self._command(cycle)
        return command.level if isinstance(command, LevelCommand) else 0.0

    def _is_within(self, low: float, high: float, cycle: DecidedCycle) -> bool:
        return low <= self._level(cycle) <= high

    def _speed_mps(self, cycle: DecidedCycle) -> float:
        command = self._command(cycle)
        return 0.0 if isinstance(command, LevelCommand) else abs(command.linear_mps)

    def _is_stopped(self, cycle: DecidedCycle) -> bool:
        return command_figures(self._command(cycle)) == command_figures(safe_command(self.output))

    def _is_acting(self, cycle: DecidedCycle) -> bool:
        return not self._is_stopped(cycle)

    def _does(self, cycle: DecidedCycle) -> str:
        command = self._command(cycle)
        if isinstance(command, LevelCommand):
            return f"level {command.level:.2f}"
        return f"{command.linear_mps:.2f} m/s, {math.degrees(command.angular_radps):.0f} deg/s"

    def _describe(self, cycle: DecidedCycle) -> str:
        trace = cycle.decision.outputs[self.index]
        why = trace.reason or cycle.decision.reasons.get(trace.winner, "")
        return f"{self._does(cycle)}, commanded by {trace.winner}: {why}"

    def _item(self, key: str) -> WatchedItem:
        return WatchedItem(self.output.name, key, self._describe)

    def _never_above(self, key: str, most: float, figure: Callable[[DecidedCycle], float], words: str) -> RuleTestWatch:
        return StateWatch(self._item(key), words, lambda cycle: figure(cycle) <= most, self._does)


def command_figures(command: Command) -> tuple[float, ...]:
    """Return the level of a command; of a base's, the speeds forwards, of turning and of tilting."""
    if isinstance(command, LevelCommand):
        return (command.level,)
    return (command.linear_mps, command.angular_radps, command.tilt_radps)
