"""Watching one expectation of a test while it runs.

A watch sees every cycle once and keeps only what its report needs: what was expected, what came instead, when, and the
rule's reason at that moment. So a test over an hour of recording needs little memory.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.decision import Decision, Event

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
    unit: str = ""
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
            got = f"{peak:.2f}{self.unit} at most, at {cycle.at_s:.2f} s"
            yield self.item.failure(f"{self.least:.2f}{self.unit} reached", got, cycle)


@dataclass(eq=False)
class CountWatch(RuleTestWatch):
    """Expects a number of events.

    Attributes:
        noun: What is counted; its plural has an s.
        most: The greatest number that will do; for each minute of the test if it is a rate.
        is_near: Whether a cycle came near to such an event, for saying why there was not one more.
    """

    item: WatchedItem
    find: FindEvents
    noun: str
    is_near: IsMet
    least: float
    most: float
    is_rate: bool = False
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
        minutes = self._cycle.at_s / 60 if self._cycle else 0.0
        most = self.most * minutes if self.is_rate else self.most
        if self.least <= self._count <= most:
            return
        expected = self._words(most) if self.least == most else f"{self._words(most)} at most"
        more = ", …" if self._count > len(self._shown) else ""
        times = f" (at {', '.join(f'{at_s:.2f} s' for at_s, _ in self._shown)}{more})" if self._shown else ""
        got = self._words(self._count) + times
        if self._count < self.least:
            yield self.item.failure(expected, got, self._near or self._cycle)
            return
        at_s, why = self._shown[min(int(most), len(self._shown) - 1)]
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
