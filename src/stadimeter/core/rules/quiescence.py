"""Which rules are quiescent, so that they need no evaluation, and which are the active set of a cycle.

Each rule says in which interval each figure that it watches may move without changing its verdict, and when it is due.
In each cycle every figure is read once, and all intervals are scanned at a stroke. An interval is about the figure, not
about the cycle before, so nothing has to be remembered while all rules are quiescent.

Thousands of rules may wake in one cycle, such as all that wait for a target to be lost for 3 s. `MAX_WOKEN` of them are
evaluated in that cycle, safety rules first and beyond that number too; the others in the cycles that follow, if they
are still due or outside their interval. One cycle that evaluates all would last longer than several frames.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.leaf import UNKNOWN, Figure, Rest, RuleInputs
from stadimeter.core.conditions.quantities import quantity_figure
from stadimeter.core.decision import Severity
from stadimeter.core.rule import ROUNDING_S, AnyRule, RampRule, conditions_of
from stadimeter.core.tracking.transverse import AskedMotion

# In one cycle this many quiescent rules are evaluated: about 5 ms if each of them raises an alarm (x86, 3 GHz).
MAX_WOKEN = 128

_Numbers = NDArray[np.float64]
_Positions = NDArray[np.intp]


class Watch(Struct, frozen=True, kw_only=True, eq=False):
    """The rows of intervals: one for each rule and each figure that it watches.

    Attributes:
        figures: Every figure that any rule watches.
        figure_of_row: The position in `figures` that each row is about.
        rule_of_row: The position of its rule in the plan.
        rows: For each rule, the row of each of its figures.
        safety: The positions of the rules for safety.
    """

    figures: tuple[Figure, ...] = ()
    figure_of_row: _Positions = field(default_factory=lambda: np.zeros(0, np.intp))
    rule_of_row: _Positions = field(default_factory=lambda: np.zeros(0, np.intp))
    rows: tuple[Mapping[Figure, int], ...] = ()
    safety: frozenset[int] = frozenset()

    @property
    def motions(self) -> frozenset[AskedMotion]:
        """The motions across the line of sight that any figure takes."""
        return frozenset(motion for figure in self.figures for motion in figure.motions)


class Quiescence(Struct, frozen=True, kw_only=True, eq=False):
    """For how long each rule is quiescent.

    Attributes:
        low: For each row, the lowest figure that changes nothing.
        high: The highest.
        due_s: For each rule, when it must be judged all the same, on the run's clock; −∞ for one that is active.
        next_due_s: The least of them.
        active: The rules that are judged in every cycle.
        first: The position from which on rules are chosen, if more wake than are evaluated in one cycle. It moves on
            with each cycle, so each of n rules that stay awake is evaluated within n / `MAX_WOKEN` cycles.
    """

    low: _Numbers = field(default_factory=lambda: np.zeros(0))
    high: _Numbers = field(default_factory=lambda: np.zeros(0))
    due_s: _Numbers = field(default_factory=lambda: np.zeros(0))
    next_due_s: float = math.inf
    active: frozenset[int] = frozenset()
    first: int = 0

    def active_set(self, watch: Watch, inputs: RuleInputs) -> set[int]:
        """Return the rules to judge in a cycle: the active ones, those with a figure outside its interval, or due."""
        woken = self._woken(watch, inputs)
        if len(woken) > MAX_WOKEN:
            woken = self._chosen(woken - self.active, watch.safety)
        return woken | self.active

    def _woken(self, watch: Watch, inputs: RuleInputs) -> set[int]:
        found: set[int] = set()
        if watch.figures:
            read = np.array([figure.read(inputs, *figure.of) for figure in watch.figures])
            values = read[watch.figure_of_row]
            outside = (values < self.low) | (values > self.high)
            if np.count_nonzero(outside):  # a sixth of the time of `any`
                found.update(watch.rule_of_row[outside].tolist())
        now_s = inputs.now_s + ROUNDING_S
        if self.next_due_s <= now_s:
            found.update((self.due_s <= now_s).nonzero()[0].tolist())
        return found

    def _chosen(self, woken: set[int], safety: frozenset[int]) -> set[int]:
        """Return the rules for safety, and of the others as many as there is time for, each in its turn."""
        urgent = woken & safety
        waiting = sorted(woken - urgent)
        turn = bisect_left(waiting, self.first)
        in_turn = waiting[turn:] + waiting[:turn]
        return urgent.union(in_turn[: max(1, MAX_WOKEN - len(urgent))])

    def after(self, watch: Watch, rests: Mapping[int, Rest | None]) -> Quiescence:
        """Return for how long each rule is quiescent after some were judged; None for those that are active."""
        changed = {index: rest for index, rest in rests.items() if rest is not None or index not in self.active}
        if not changed:
            return self
        due_s = self.due_s.copy()
        low, high = self.low.copy(), self.high.copy()
        for index, rest in changed.items():
            due_s[index] = math.inf if rest is None else rest.due_s
            rows = watch.rows[index]
            for row in rows.values():
                low[row], high[row] = UNKNOWN, math.inf
            for figure, least, most in rest.intervals if rest is not None else ():
                row = rows[figure]
                low[row], high[row] = max(low[row], least), min(high[row], most)
        active = {index for index, rest in changed.items() if rest is None}
        return Quiescence(
            low=low,
            high=high,
            due_s=due_s,
            next_due_s=float(due_s.min()),
            active=(self.active - changed.keys()) | active,
            first=(self.first + MAX_WOKEN) % len(due_s),
        )

    def with_all_active(self) -> Quiescence:
        """Return the same with every rule active."""
        return replace(self, active=frozenset(range(len(self.due_s))))


def watch_of(rules: Sequence[AnyRule]) -> Watch:
    """Return the rows of intervals for rules, in the order of the plan."""
    figures: dict[Figure, int] = {}
    rows: list[dict[Figure, int]] = []
    figure_of_row: list[int] = []
    rule_of_row: list[int] = []
    for index, rule in enumerate(rules):
        of_rule: dict[Figure, int] = {}
        for figure in dict.fromkeys(_watched(rule)):
            of_rule[figure] = len(rule_of_row)
            figure_of_row.append(figures.setdefault(figure, len(figures)))
            rule_of_row.append(index)
        rows.append(of_rule)
    return Watch(
        figures=tuple(figures),
        figure_of_row=np.array(figure_of_row, np.intp),
        rule_of_row=np.array(rule_of_row, np.intp),
        rows=tuple(rows),
        safety=frozenset(index for index, rule in enumerate(rules) if rule.severity is Severity.SAFETY),
    )


def all_active(watch: Watch) -> Quiescence:
    """Return that every rule is active, as at the start of a run."""
    rows = len(watch.rule_of_row)
    return Quiescence(
        low=np.full(rows, UNKNOWN), high=np.full(rows, math.inf), due_s=np.full(len(watch.rows), math.inf)
    ).with_all_active()


def _watched(rule: AnyRule) -> Iterator[Figure]:
    if isinstance(rule, RampRule):
        yield quantity_figure(rule.target, rule.quantity)
    for condition in conditions_of(rule):
        for leaf in leaves(condition):
            yield from leaf.figures()
