"""Conditions on what other rules did within a window of time: how often they were raised, how long they were active.

What each remembers is a `Tally`, in the record of the alarm whose condition it is part of: so it survives a restart as
the alarm does, and a reset of the alarm empties it. An alarm that asks for other rules is judged in each cycle in which
one of them changes, after it: nothing is missed while it is quiescent.

Memory is bounded, whatever comes: `MAX_RAISES` moments, or `MAX_SPANS` spans of time. Of more spans, the two with the
least gap between them are joined: the earlier one is moved by that gap, which is less than 1/256 of the window.
"""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.bounds import MAX_DURATION_S, MIN_QUANTITY
from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, Rest, RuleInputs, Threshold
from stadimeter.core.conditions.window import ROUNDING_S, Tally, Window, packed, unpacked
from stadimeter.core.observation import WallTime
from stadimeter.core.words import duration, rounded_duration

# So many raises are remembered at most, in 8 kB; and so many spans, in 4 kB.
MAX_RAISES = 1000
MAX_SPANS = 256


class TallyCondition(Leaf):
    """The base of both: a figure of what other rules did is at least so much."""

    __slots__ = ()

    is_by_cycle = True
    rules: tuple[str, ...]
    """The rules, one for each target of a table with several: any of them counts."""
    window: Window

    @property
    def least(self) -> float:
        """The figure from which on it holds."""
        raise NotImplementedError

    @property
    def rules_named(self) -> tuple[str, ...]:
        """Those whose deeds it counts."""
        return self.rules

    def step(
        self, tally: Tally, now_s: float, *, is_active: bool, gap_s: float = 0.0, wall: WallTime | None = None
    ) -> Tally:
        """Return what it remembers after a cycle; the same object if that has not changed.

        Args:
            is_active: Whether one of its rules is active.
            gap_s: How long before it nothing was judged: that time is no active time.
        """
        since_s, times = tally.active_since_s, tally.times
        began_s = self.window.began_s(tally.began_s, now_s, wall)
        if since_s is not None and (gap_s or not is_active):
            start_s = self.window.start_s(began_s, now_s)
            times = self._with_end(times, since_s, now_s - gap_s, -math.inf if start_s is None else start_s)
            since_s = max(since_s, now_s) if is_active else None
        elif since_s is None and is_active:
            since_s, times = now_s, self._with_raise(times, now_s)
        same = since_s == tally.active_since_s and times is tally.times and began_s == tally.began_s
        return tally if same else Tally(times=times, active_since_s=since_s, began_s=began_s)

    def resume(self, tally: Tally, shift_s: float, from_s: float, now_s: float) -> Tally:
        """Return what it remembers at the beginning of a run; time off is no active time.

        Args:
            shift_s: What to add to a time on the earlier run's clock.
            from_s: As of when it was remembered, on this run's clock.
        """
        since_s = None if tally.active_since_s is None else tally.active_since_s + shift_s
        moved = Tally(times=packed(at_s + shift_s for at_s in unpacked(tally.times)), active_since_s=since_s)
        ended = self.step(moved, from_s, is_active=False)
        return Tally(times=ended.times, active_since_s=None if since_s is None else now_s)

    def figure(self, tally: Tally, now_s: float) -> float | None:
        """Return what the rules did within the window; None while it is not known when that began."""
        start_s = self.window.start_s(tally.began_s, now_s)
        return None if start_s is None else self._since(tally, start_s, now_s)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002 - nothing is unsure of it
        """Return whether it holds; None while the time of day is not known at which its window begins."""
        tally = inputs.tallies.get(self)
        figure = None if tally is None else self.figure(tally, inputs.now_s)
        return None if figure is None else figure >= self.least - ROUNDING_S

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest | None:
        """Return that it stays as it is until its figure may be at its threshold, or its rules change.

        A window that begins at a time of day is judged in every cycle: that goes by another clock, which may jump.
        """
        tally = inputs.tallies.get(self)
        if tally is None or self.window.from_second is not None:
            return None
        return Rest((), self._due_s(tally, inputs.now_s, holds=bool(self.holds(inputs, is_on))))

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return what the rules did, and the threshold."""
        tally = inputs.tallies.get(self)
        figure = None if tally is None else self.figure(tally, inputs.now_s)
        return None if figure is None else JudgedFigure(value=figure, low=self.least)

    def words_of(self, figure: float | None) -> str:
        """Return a figure in words, such as ``raised 2 times``; None for one that is not known."""
        raise NotImplementedError

    def own_words(self, inputs: RuleInputs) -> str:
        """Return the figure behind its verdict, in words."""
        reading = self.reading(inputs, is_on=False)
        words = f"{self._named('')} {self.words_of(reading.value if reading else None)}"
        unknown = "" if reading else "; the time of day is not known yet"
        return f"{words} {self.window}, {self.words_of(self.least).partition(' ')[2]} at least{unknown}"

    def begin_words(self) -> str:
        """Return when it holds, in words."""
        verb, _, amount = self.words_of(self.least).partition(" ")
        return f"{self._named('`')} was {verb} at least {amount} {self.window}"

    def _named(self, quote: str) -> str:
        return " or ".join(f"{quote}{rule}{quote}" for rule in self.rules)

    def _with_raise(self, times: bytes, now_s: float) -> bytes:  # noqa: ARG002 - by one kind
        return times

    def _with_end(self, times: bytes, since_s: float, until_s: float, start_s: float) -> bytes:  # noqa: ARG002
        return times

    def _since(self, tally: Tally, start_s: float, now_s: float) -> float:
        raise NotImplementedError

    def _due_s(self, tally: Tally, now_s: float, *, holds: bool) -> float:
        raise NotImplementedError


class RaisedCondition(TallyCondition, Struct, frozen=True, kw_only=True):
    """Other rules were raised this often.

    Attributes:
        at_least: Holds with no fewer raises; only so many are remembered.
    """

    rules: tuple[str, ...]
    at_least: int
    window: Window = Window()

    @property
    def noun(self) -> str:
        """Raises within the window."""
        return f"raises {self.window}"

    @property
    def limits(self) -> tuple[float, float]:
        """Whole numbers."""
        return self.at_least - 0.5, math.inf

    @property
    def least(self) -> float:
        """As a number of raises."""
        return float(self.at_least)

    def words_of(self, figure: float | None) -> str:
        """Return how often."""
        return "raised ? times" if figure is None else f"raised {figure:.0f} time{'' if figure == 1 else 's'}"

    def _with_raise(self, times: bytes, now_s: float) -> bytes:
        return (times + packed((now_s,)))[-8 * self.at_least :]

    def _since(self, tally: Tally, start_s: float, now_s: float) -> float:  # noqa: ARG002
        return float(sum([at_s > start_s for at_s in unpacked(tally.times)]))

    def _due_s(self, tally: Tally, now_s: float, *, holds: bool) -> float:  # noqa: ARG002
        return unpacked(tally.times)[-self.at_least] + self.window.for_s - ROUNDING_S if holds else math.inf


class ActiveForCondition(TallyCondition, Struct, frozen=True, kw_only=True):
    """Other rules were active for this long in all.

    Attributes:
        at_least_s: Holds from this time on.
    """

    rules: tuple[str, ...]
    at_least_s: float
    window: Window = Window()

    unit = "s"

    @property
    def noun(self) -> str:
        """Active time within the window."""
        return f"active time {self.window}"

    @property
    def limits(self) -> tuple[float, float]:
        """In seconds."""
        return self.at_least_s, math.inf

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The time."""
        return (Threshold("active_for.at_least", "at_least_s", MIN_QUANTITY, MAX_DURATION_S),)

    @property
    def least(self) -> float:
        """In seconds."""
        return self.at_least_s

    def words_of(self, figure: float | None) -> str:
        """Return how long."""
        exact = figure == self.at_least_s
        return f"active for {'?' if figure is None else duration(figure) if exact else rounded_duration(figure)}"

    def _with_end(self, times: bytes, since_s: float, until_s: float, start_s: float) -> bytes:
        """Add a span; drop those before the window; of too many, join the two that are least apart."""
        if until_s <= since_s:
            return times
        ends = [*unpacked(times), since_s, until_s]
        while ends[1] <= start_s and len(ends) > 2:
            del ends[:2]
        if len(ends) > 2 * MAX_SPANS:
            gap_s, first = min((ends[at + 1] - ends[at], at) for at in range(1, len(ends) - 1, 2))
            ends[first - 1] += gap_s
            del ends[first : first + 2]
        return packed(ends)

    def _since(self, tally: Tally, start_s: float, now_s: float) -> float:
        ends = unpacked(tally.times)
        if tally.active_since_s is not None:
            ends += [tally.active_since_s, now_s]
        return math.fsum(
            [max(0.0, end_s - max(from_s, start_s)) for from_s, end_s in zip(ends[::2], ends[1::2], strict=True)]
        )

    def _due_s(self, tally: Tally, now_s: float, *, holds: bool) -> float:
        """Within a second the sum grows or shrinks by no more than a second."""
        if not holds and tally.active_since_s is None:
            return math.inf
        figure_s = self._since(tally, now_s - self.window.for_s, now_s)
        return now_s + abs(figure_s - self.at_least_s)


def resume_tallies(
    leaves: tuple[TallyCondition, ...], tallies: tuple[Tally, ...], shift_s: float, from_s: float, now_s: float
) -> tuple[Tally, ...]:
    """Return what conditions remember at the beginning of a run; see `TallyCondition.resume`."""
    pairs = zip(leaves, tallies, strict=True)
    return tuple([leaf.resume(tally, shift_s, from_s, now_s) for leaf, tally in pairs])


def step_tallies(
    leaves: tuple[TallyCondition, ...], tallies: tuple[Tally, ...], inputs: RuleInputs
) -> tuple[Tally, ...]:
    """Return what conditions remember after a cycle; the same object if nothing of it has changed."""
    after = tuple(
        [
            leaf.step(
                tally,
                inputs.now_s,
                is_active=True in [inputs.active.get(rule) for rule in leaf.rules],
                gap_s=inputs.gap_s,
                wall=inputs.wall,
            )
            for leaf, tally in zip(leaves, tallies, strict=True)
        ]
    )
    return tallies if all(now is was for now, was in zip(after, tallies, strict=True)) else after
