"""Comparing a replay with its recording: decisions bit by bit, and distances that are measured again."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Literal

import msgspec
from msgspec import Struct, field

from stadimeter.app.exact_json import plain
from stadimeter.app.recordings.journal import RecordedCycle
from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.decision import Decision, Event, RuleTrace
from stadimeter.core.observation import Observation
from stadimeter.errors import JournalError
from stadimeter.workbench.replay.replay import ReplayRun
from stadimeter.workbench.replay.replay_figures import RuleFigures, Tally

# At most this many decisions that differ are shown field by field.
SHOWN_DIFFERENCES = 10


class Difference(Struct, kw_only=True):
    """A cycle, counted from 0, in which parts of the decision are not the recorded ones."""

    cycle: int
    now_s: float
    what: tuple[str, ...]


class ReplayResult(Struct, kw_only=True):
    """Counts and events of a replay beside those of its recording.

    Attributes:
        identical: Cycles in which the decision was the recorded one, to the last bit.
    """

    cycles: int = 0
    identical: int = 0
    events: list[Event] = field(default_factory=list)
    recorded_events: list[Event] = field(default_factory=list)
    differences: list[Difference] = field(default_factory=list)
    frames: int = 0
    recorded_frames: int = 0
    targets: set[str] = field(default_factory=set)


class Comparison:
    """Compares decisions with recorded ones."""

    def __init__(self) -> None:
        self.result = ReplayResult()

    def add(self, cycle: RecordedCycle, observation: Observation, decision: Decision) -> None:
        """Add one cycle; raises JournalError if the recorded one is damaged."""
        result = self.result
        if observation.frame is not None:
            result.frames += 1
            result.targets.update([measured.target for measured in observation.measurements])
        result.recorded_frames += cycle.has_frame()
        result.events += decision.events
        recorded = cycle.decision()
        result.recorded_events += recorded.events
        if decision == recorded:
            result.identical += 1
        elif len(result.differences) < SHOWN_DIFFERENCES:
            what = _differing(decision, recorded)
            result.differences.append(Difference(cycle=result.cycles, now_s=observation.now_s, what=what))
        result.cycles += 1


def _differing(decision: Decision, recorded: Decision) -> tuple[str, ...]:
    return tuple(
        name
        for name in Decision.__struct_fields__
        if name != "reasons" and getattr(decision, name) != getattr(recorded, name)
    )


class MeasuredAgain(Struct, frozen=True, kw_only=True):
    """One target in the pictures of a recording.

    Attributes:
        frames: Pictures in which it was looked for again.
        found_before: Those of them in which it was measured when they were recorded.
        found_again: Those of them in which it is measured now.
        differs_median_m: Median difference of the two distances; None if it was never measured both times.
    """

    target: str
    frames: int
    found_before: int
    found_again: int
    differs_median_m: float | None = None
    differs_most_m: float | None = None


class AgainTally:
    """Compares measurements through a replay."""

    def __init__(self) -> None:
        self._pairs: dict[str, list[tuple[float | None, float | None]]] = {}

    def add(self, before: Observation, again: Observation) -> None:
        """Add what was observed in a cycle when it was recorded, and what is measured in it again."""
        before_m = {measured.target: measured.distance_m for measured in before.measurements}
        for measured in again.measurements:
            pair = before_m.get(measured.target), measured.distance_m
            self._pairs.setdefault(measured.target, []).append(pair)

    def targets(self) -> tuple[MeasuredAgain, ...]:
        """Return the comparison of each target."""
        return tuple(_compare_target(target, pairs) for target, pairs in self._pairs.items())


def _compare_target(target: str, pairs: list[tuple[float | None, float | None]]) -> MeasuredAgain:
    apart_m = [abs(again_m - before_m) for before_m, again_m in pairs if before_m is not None and again_m is not None]
    return MeasuredAgain(
        target=target,
        frames=len(pairs),
        found_before=sum(before_m is not None for before_m, _ in pairs),
        found_again=sum(again_m is not None for _, again_m in pairs),
        differs_median_m=median(apart_m) if apart_m else None,
        differs_most_m=max(apart_m, default=None),
    )


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


class ReplayDiff(Struct, frozen=True, kw_only=True):
    """The difference that new rules make: changed events in order of time, and the figures of each rule."""

    changes: tuple[EventChange, ...]
    same: int
    rules: tuple[RuleChange, ...]
    minutes: float

    def summary(self) -> str:
        """Say how many events are the same, and how many are not."""
        counts = {kind: sum(change.change == kind for change in self.changes) for kind in ("added", "lost", "moved")}
        counted = ", ".join(f"{count} {kind}" for kind, count in counts.items())
        return f"{self.same} events are the same, {counted}, in {self.minutes:.1f} minutes."

    def record(self) -> dict[str, Any]:
        """Return the object that ``--json`` prints."""
        return {
            "minutes": self.minutes,
            "same_events": self.same,
            "changes": [plain(change) for change in self.changes],
            "rules": [plain(rule) for rule in self.rules],
        }


def compare(old: Tally, new: Tally) -> ReplayDiff:
    """Compare two replays of one recording."""
    changes: list[EventChange] = []
    same = 0
    old_events, new_events = _by_subject(old.events), _by_subject(new.events)
    for subject in {**old_events, **new_events}:
        for before, after in _pair_events(old_events[subject], new_events[subject]):
            change = _change(before, after)
            changes += [change] if change else []
            same += change is None
    changes.sort(key=lambda change: (change.event.at_s, change.event.sequence, change.change))
    return ReplayDiff(changes=tuple(changes), same=same, rules=_rules(old, new), minutes=new.minutes)


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


def _rules(old: Tally, new: Tally) -> tuple[RuleChange, ...]:
    before = {figures.rule: figures for figures in old.figures()}
    after = {figures.rule: figures for figures in new.figures()}
    return tuple(RuleChange(rule=name, old=before.get(name), new=after.get(name)) for name in {**after, **before})


# Two configurations over a recording, side by side, for a picture: when rules acted, and what outputs did -------------
#
# Both decide on every cycle. Only what is drawn is thinned out: of each short span of distances and levels the
# lowest and the highest stay, so that no peak is lost.

# A chart as wide as a screen has no more pixels.
POINTS_MAX = 1500

# Nearly four hours at 30 a second: what is gone through is kept, and a small Pi has little memory.
CYCLES_MAX = 400_000

# A time, a distance or None, and its standard deviation.
Point = tuple[float, float | None, float]


class Lane(Struct):
    """When something was on, as spans that do not touch each other."""

    spans: list[tuple[float, float]] = msgspec.field(default_factory=list)
    _is_on: bool = False

    def add(self, at_s: float, *, is_on: bool) -> None:
        """Add a moment; moments come in order."""
        if is_on and self._is_on:
            self.spans[-1] = self.spans[-1][0], at_s
        elif is_on:
            self.spans.append((at_s, at_s))
        elif self._is_on:
            self.spans[-1] = self.spans[-1][0], at_s
        self._is_on = is_on


class ReplaySide(Struct):
    """The decisions of one configuration."""

    tally: Tally
    rules: dict[str, Lane] = msgspec.field(default_factory=dict)
    levels: dict[str, list[Point]] = msgspec.field(default_factory=dict)

    def add(self, at_s: float, observation: Observation, decision: Decision) -> None:
        """Add a cycle."""
        self.tally.add(observation, decision)
        self.add_lanes(at_s, decision.rules)
        for command in decision.commands:
            _add_changed(self.levels.setdefault(command.output, []), at_s, _strength(command))

    def add_lanes(self, at_s: float, traces: Iterable[RuleTrace]) -> None:
        """Add whether rules are active at a moment."""
        for trace in traces:
            self.rules.setdefault(trace.rule, Lane()).add(at_s, is_on=trace.active is True)


@dataclass(slots=True)
class SideBySide:
    """Replays a recording with two configurations at once, a part at a time.

    Attributes:
        began_s: The time of the first cycle, on the run's clock.
        before: The run that is compared with, such as that of the recording itself.
        seconds: The time of the last cycle, since the beginning of the recording.
        is_done: Whether that is the end, or `CYCLES_MAX` is reached.
        damage: Why the recording cannot be read to its end; empty if it can.
        targets: The targets that were looked for.
    """

    before: ReplayRun
    after: ReplayRun
    began_s: float = 0.0
    seconds: float = 0.0
    cycles: int = 0
    is_done: bool = False
    damage: str = ""
    targets: set[str] = dataclasses.field(default_factory=set)
    samples: dict[str, list[Point]] = dataclasses.field(default_factory=dict)
    old: ReplaySide = dataclasses.field(init=False)
    new: ReplaySide = dataclasses.field(init=False)
    _cycles: Iterator[None] = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        self.old = ReplaySide(Tally(self.before.configuration.plan))
        self.new = ReplaySide(Tally(self.after.configuration.plan))
        self._cycles = self._through()

    def go_on(self, for_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Go on for this long, or to the end; damage ends it as well."""
        until_s = clock() + for_s
        while clock() < until_s and not self.is_done:
            try:
                self.is_done = next(self._cycles, self) is self
            except JournalError as error:
                self.damage, self.is_done = str(error), True

    def difference(self) -> ReplayDiff:
        """Return the differences between the two so far."""
        return compare(self.old.tally, self.new.tally)

    def _through(self) -> Iterator[None]:
        for (_, observation, old), (_, _, new) in zip(self.before, self.after, strict=False):
            if not self.cycles:
                self.began_s = observation.now_s
            self.cycles += 1
            self.seconds = observation.now_s - self.began_s
            self.targets.update([measured.target for measured in observation.measurements])
            self.old.add(self.seconds, observation, old)
            self.new.add(self.seconds, observation, new)
            for track in new.tracks:
                distance_m = track.distance_m if track.is_valid else None
                self.samples.setdefault(track.target, []).append((self.seconds, distance_m, track.sigma_m or 0.0))
            yield
            if self.cycles >= CYCLES_MAX:
                return


def thin_points(points: list[Point]) -> list[Point]:
    """Return no more than `POINTS_MAX` of them, with the lowest and the highest of each short span, and each gap."""
    if len(points) <= POINTS_MAX:
        return points
    size = math.ceil(len(points) / (POINTS_MAX // 3))
    return [each for begin in range(0, len(points), size) for each in _extremes(points[begin : begin + size])]


def _extremes(points: list[Point]) -> Iterable[Point]:
    known = [each for each in points if each[1] is not None]
    unknown = [each for each in points if each[1] is None][:1]
    kept = [min(known, key=_height), max(known, key=_height)] if known else []
    return sorted({*kept, *unknown})


def _height(point: Point) -> float:
    return point[1] if point[1] is not None else 0.0


def _add_changed(levels: list[Point], at_s: float, level: float) -> None:
    """Add the level of an output where it changes: the last moment of the old one, and the first of the new one."""
    if len(levels) > 1 and levels[-1][1] == levels[-2][1] == level:
        levels[-1] = (at_s, level, 0.0)
    else:
        levels.append((at_s, level, 0.0))


def _strength(command: Command) -> float:
    """Return the strength with which an output acts: its level, or the speed of a base in m/s."""
    return command.level if isinstance(command, LevelCommand) else command.linear_mps
