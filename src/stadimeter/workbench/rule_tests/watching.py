"""Watching one expectation of a test while it runs.

A watcher sees every cycle once and keeps only what its report needs: what was expected, what came instead, when, and
the rule's reason at that moment. So a test over an hour of recording needs little memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import InitVar, dataclass, field
from typing import Protocol

from stadimeter.config.rule_test_tables import SpanTable
from stadimeter.core.decision import Decision, Event

SHOWN_EVENTS = 5
_ROUNDING_S = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class DecidedCycle:
    """One cycle of a test.

    Attributes:
        at_s: When, in seconds from the start of the test.
        start_s: The start of the test, on the clock that events are stamped with.
    """

    at_s: float
    start_s: float
    decision: Decision


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
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


class Watcher(Protocol):
    """Watches one expectation."""

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        ...

    def failures(self) -> Iterator[Failure]:
        """Yield what was not met, after the last cycle."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchedItem:
    """What an expectation is about.

    Attributes:
        doing: Says what the rule or output does in a cycle, and why.
    """

    name: str
    key: str
    doing: Callable[[DecidedCycle], str]

    def failure(self, expected: str, got: str, cycle: DecidedCycle | None = None) -> Failure:
        """Return a failure of it, at a cycle if there is one."""
        at_s, why = (None, "") if cycle is None else (cycle.at_s, self.doing(cycle))
        return Failure(subject=self.name, key=self.key, expected=expected, got=got, at_s=at_s, why=why)


@dataclass(eq=False, slots=True)
class MomentWatch:
    """Expects something at certain moments, or throughout certain stretches.

    Args:
        moments: When, in seconds, each with what is expected then in words and how to tell.
    """

    subject: WatchedItem
    moments: InitVar[Iterable[tuple[float | SpanTable, str, Callable[[DecidedCycle], bool]]]]
    _open: list[tuple[float | SpanTable, str, Callable[[DecidedCycle], bool]]] = field(init=False)
    _before: DecidedCycle | None = field(default=None, init=False)
    _failures: list[Failure] = field(default_factory=list, init=False)

    def __post_init__(self, moments: Iterable[tuple[float | SpanTable, str, Callable[[DecidedCycle], bool]]]) -> None:
        self._open = list(moments)

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle: it ends the one before, whose moments can be judged now."""
        self._judge(cycle.at_s)
        self._before = cycle

    def failures(self) -> Iterator[Failure]:
        """Yield what was not met."""
        last_s = self._before.at_s if self._before else 0.0
        self._judge(last_s + 2 * _ROUNDING_S)
        yield from self._failures
        for moment, expected, _ in self._open:
            if isinstance(moment, float) or moment.end_s > last_s + _ROUNDING_S:
                when_s = moment.end_s if isinstance(moment, SpanTable) else moment
                got = f"the test was over at {last_s:.2f} s"
                yield self.subject.failure(f"{expected} at {when_s:.2f} s", got, self._before)

    def _judge(self, next_s: float) -> None:
        if self._open and self._before is not None:
            self._open = [each for each in self._open if self._is_open(self._before, next_s, *each)]

    def _is_open(
        self,
        cycle: DecidedCycle,
        next_s: float,
        moment: float | SpanTable,
        expected: str,
        is_met: Callable[[DecidedCycle], bool],
    ) -> bool:
        """Judge a moment in the cycle that is current then; return whether it must be looked at again."""
        start_s, end_s = (moment.start, moment.end_s) if isinstance(moment, SpanTable) else (moment, moment)
        if next_s <= start_s + _ROUNDING_S:
            return True
        if not is_met(cycle):
            when = f"at {start_s:.2f} s" if start_s == end_s else f"from {start_s:.2f} s to {end_s:.2f} s"
            self._failures.append(self.subject.failure(f"{expected} {when}", f"not so at {cycle.at_s:.2f} s", cycle))
            return False
        return next_s <= end_s - _ROUNDING_S


@dataclass(eq=False, slots=True)
class _Expectation:
    """What is expected of a cycle, and what is said of the cycle in which it was not met."""

    subject: WatchedItem
    expected: str
    is_met: Callable[[DecidedCycle], bool]
    got: Callable[[DecidedCycle], str]
    _cycle: DecidedCycle | None = field(default=None, init=False)


class AlwaysWatch(_Expectation):
    """Expects something in every cycle."""

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        if self._cycle is None and not self.is_met(cycle):
            self._cycle = cycle

    def failures(self) -> Iterator[Failure]:
        """Yield the first cycle in which it was not met."""
        if self._cycle is not None:
            got = f"{self.got(self._cycle)} at {self._cycle.at_s:.2f} s"
            yield self.subject.failure(self.expected, got, self._cycle)


@dataclass(eq=False, slots=True)
class PeakWatch:
    """Expects a figure to be reached at some time."""

    subject: WatchedItem
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
            yield self.subject.failure(f"{self.least:.2f}{self.unit} reached", got, cycle)


class EndWatch(_Expectation):
    """Expects something in the last cycle."""

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        self._cycle = cycle

    def failures(self) -> Iterator[Failure]:
        """Yield what is wrong at the end."""
        if self._cycle is not None and not self.is_met(self._cycle):
            yield self.subject.failure(f"{self.expected} at the end", self.got(self._cycle), self._cycle)


@dataclass(eq=False, slots=True)
class CountWatch:
    """Expects a number of events.

    Args:
        limits: The least and the greatest number that will do, given how many seconds the test took.
        noun: What is counted, in words: one, and several.
        is_near: Tells whether a cycle came near to such an event, for saying why there was not one more.
    """

    subject: WatchedItem
    counted: Callable[[DecidedCycle], Iterable[Event]]
    limits: Callable[[float], tuple[float, float]]
    noun: tuple[str, str]
    is_near: Callable[[DecidedCycle], bool]
    _count: int = field(default=0, init=False)
    _shown: list[tuple[float, str]] = field(default_factory=list, init=False)
    _near: DecidedCycle | None = field(default=None, init=False)
    _cycle: DecidedCycle | None = field(default=None, init=False)

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        if self.is_near(cycle):
            self._near = cycle
        for event in self.counted(cycle):
            self._count += 1
            self._near = None
            if len(self._shown) < SHOWN_EVENTS:
                self._shown.append((event.at_s - cycle.start_s, f"{event.kind.value}: {event.reason}"))
        self._cycle = cycle

    def failures(self) -> Iterator[Failure]:
        """Yield the count if it is wrong, with the first event too many, or the moment that came nearest."""
        least, most = self.limits(self._cycle.at_s if self._cycle else 0.0)
        if least <= self._count <= most:
            return
        expected = self._words(least) if least == most else f"{self._words(most)} at most"
        got = self._words(self._count) + self._times()
        if self._count < least:
            yield self.subject.failure(expected, got, self._near or self._cycle)
            return
        at_s, why = self._shown[min(int(most), len(self._shown) - 1)]
        yield Failure(subject=self.subject.name, key=self.subject.key, expected=expected, got=got, at_s=at_s, why=why)

    def _words(self, count: float) -> str:
        return f"{count:g} {self.noun[count != 1]}"

    def _times(self) -> str:
        if not self._shown:
            return ""
        more = ", …" if self._count > len(self._shown) else ""
        return f" (at {', '.join(f'{at_s:.2f} s' for at_s, _ in self._shown)}{more})"


class FirstWatch:
    """Expects the first event of a kind within a stretch of time.

    Args:
        verb: What happens, in words, such as ``raised``.
        stretch_s: The earliest and the latest time that will do.
    """

    def __init__(
        self,
        subject: WatchedItem,
        counted: Callable[[DecidedCycle], Iterable[Event]],
        verb: str,
        stretch_s: tuple[float, float],
        expected: str,
    ) -> None:
        self._subject = subject
        self._counted = counted
        self._verb = verb
        self._not_before_s, self._by_s = stretch_s
        self._expected = expected
        self._first: tuple[float, DecidedCycle] | None = None
        self._at_limit: DecidedCycle | None = None

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        if self._first is None:
            event = next(iter(self._counted(cycle)), None)
            self._first = (event.at_s - cycle.start_s, cycle) if event else None
        if cycle.at_s <= self._by_s + _ROUNDING_S:
            self._at_limit = cycle

    def failures(self) -> Iterator[Failure]:
        """Yield when it happened, if that is not within the stretch; and what was so at its end."""
        if self._first is None:
            yield self._subject.failure(self._expected, f"never {self._verb}", self._at_limit)
            return
        at_s, cycle = self._first
        got = f"{self._verb} at {at_s:.2f} s"
        if at_s < self._not_before_s - _ROUNDING_S:
            yield self._subject.failure(self._expected, got, cycle)
        elif at_s > self._by_s + _ROUNDING_S:
            late = f"{got}, {at_s - self._by_s:.2f} s late"
            yield self._subject.failure(self._expected, late, self._at_limit)


class WithinWatch(FirstWatch):
    """Expects the first event of a kind soon after a condition holds.

    Args:
        is_met: Whether the condition holds in a cycle; called in every cycle until it does.
    """

    def __init__(
        self,
        subject: WatchedItem,
        counted: Callable[[DecidedCycle], Iterable[Event]],
        verb: str,
        within_s: float,
        is_met: Callable[[DecidedCycle], bool],
        words: str,
    ) -> None:
        super().__init__(subject, counted, verb, (0.0, math.inf), "")
        self._within_s = within_s
        self._is_met = is_met
        self._words = words
        self._met_at_s: float | None = None

    def see(self, cycle: DecidedCycle) -> None:
        """Take in the next cycle."""
        if self._met_at_s is None and self._is_met(cycle):
            self._met_at_s = cycle.at_s
            self._by_s = cycle.at_s + self._within_s
            when = f"{cycle.at_s:.2f} s, where its condition truly {self._words}"
            self._expected = f"{self._verb} within {self._within_s:.2f} s of {when}"
        super().see(cycle)

    def failures(self) -> Iterator[Failure]:
        """Yield when it happened, if that is too late, or that it never had to happen."""
        if self._met_at_s is None:
            yield self._subject.failure(f"its condition truly {self._words}", "it never does")
        else:
            yield from super().failures()
