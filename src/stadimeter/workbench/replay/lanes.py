"""Two configurations over a recording, side by side, for a picture: when rules acted, and what outputs did.

Both decide on every cycle. Only what is drawn is thinned out: of each short span of distances and levels the lowest and
the highest stay, so that no peak is lost.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import msgspec
from msgspec import Struct

from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.decision import Decision, RuleTrace
from stadimeter.core.observation import Observation
from stadimeter.errors import JournalError
from stadimeter.workbench.replay.comparison import ReplayDiff, compare
from stadimeter.workbench.replay.replay import ReplayRun
from stadimeter.workbench.replay.replay_figures import Tally

# A chart as wide as a screen has no more pixels.
POINTS_MAX = 1500

# The number of spans of a lane; more cannot be told apart on a screen.
SPANS_MAX = 500

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

    def thinned(self) -> list[tuple[float, float]]:
        """Return the spans, those joined that are nearest to each other if there are too many."""
        if len(self.spans) <= SPANS_MAX:
            return self.spans
        gaps_s = [later[0] - earlier[1] for earlier, later in pairwise(self.spans)]
        by_width = sorted(range(len(gaps_s)), key=gaps_s.__getitem__)
        kept = sorted(by_width[len(self.spans) - SPANS_MAX :])
        begins = [self.spans[0][0], *(self.spans[each + 1][0] for each in kept)]
        ends = [*(self.spans[each][1] for each in kept), self.spans[-1][1]]
        return list(zip(begins, ends, strict=True))


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
    targets: set[str] = field(default_factory=set)
    samples: dict[str, list[Point]] = field(default_factory=dict)
    old: ReplaySide = field(init=False)
    new: ReplaySide = field(init=False)
    _cycles: Iterator[None] = field(init=False)

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
