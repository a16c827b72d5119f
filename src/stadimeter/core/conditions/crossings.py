"""Which rules a change of a figure concerns: those with a limit on its way, found by bisection."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from stadimeter.core.condition import (
    ClosingCondition,
    CountCondition,
    DirectionCondition,
    DistanceCondition,
    Leaf,
    PresenceCondition,
    SeparationCondition,
    TimeToContactCondition,
    leaves,
)
from stadimeter.core.conditions.contact import sigmas_that_count
from stadimeter.core.conditions.figures import (
    PACE_LIMITS,
    ClosingFigure,
    ContactFigure,
    CountFigure,
    DirectionFigure,
    DistanceFigure,
    Figure,
    PaceFigure,
    PresenceFigure,
    SeparationFigure,
)
from stadimeter.core.conditions.known import Known
from stadimeter.core.conditions.thresholds import LimitsCondition, limits_of
from stadimeter.core.rule import AlarmRule, AnyRule, RampRule

_Limits = tuple[Figure, tuple[float, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossings:
    """The limits of all rules that are judged by one figure.

    Attributes:
        of: The figure.
        limits: The limits in the SI unit, smallest first.
        owners: For each limit, the position of its rule in the plan.
        all_owners: The positions of all rules that are judged by the figure.
    """

    of: Figure
    limits: tuple[float, ...]
    owners: tuple[int, ...]
    all_owners: tuple[int, ...]

    def figure(self, known: Known) -> float:
        """Return the figure.

        Args:
            known: What is known in this cycle.

        Returns:
            The figure in the SI unit; NaN while it is not known.
        """
        return self.of.of(known)

    def between(self, before: float, now: float) -> tuple[int, ...]:
        """Return the rules that a change of the figure concerns.

        Args:
            before: The figure before; NaN if it was not known.
            now: The figure now.

        Returns:
            The positions of the rules with a limit on the way; of all rules, if the figure came or went.
        """
        if math.isnan(before) or math.isnan(now):
            is_unknown_still = math.isnan(before) and math.isnan(now)
            return () if is_unknown_still else self.all_owners
        first = bisect_left(self.limits, min(before, now))
        return self.owners[first : bisect_right(self.limits, max(before, now))]


def crossings_of(rules: Sequence[AnyRule]) -> tuple[Crossings, ...]:
    """Return the limits of rules, sorted.

    Args:
        rules: The rules, in the order of the plan.

    Returns:
        One for each figure that any rule is judged by.
    """
    limits: dict[Figure, list[tuple[float, int]]] = defaultdict(list)
    owners: dict[Figure, dict[int, None]] = defaultdict(dict)
    for index, rule in enumerate(rules):
        for figure, values in _of_rule(rule):
            limits[figure] += [(value, index) for value in values]
            owners[figure][index] = None
    return tuple(_crossings(figure, sorted(limits[figure]), tuple(indices)) for figure, indices in owners.items())


def _crossings(figure: Figure, limits: list[tuple[float, int]], owners: tuple[int, ...]) -> Crossings:
    return Crossings(
        of=figure,
        limits=tuple([value for value, _ in limits]),
        owners=tuple([index for _, index in limits]),
        all_owners=owners,
    )


def _of_rule(rule: AnyRule) -> Iterator[_Limits]:
    match rule:
        case AlarmRule():
            for condition in (rule.condition, rule.suppress_when):
                for leaf in leaves(condition) if condition is not None else ():
                    yield from _of_leaf(leaf)
        case RampRule():
            yield DistanceFigure(rule.target, rule.quantity), _ends_m(rule)
        case _:
            yield DistanceFigure(rule.target, "distance"), ()


def _ends_m(rule: RampRule) -> tuple[float, ...]:
    return tuple(distance_m for distance_m, _ in rule.points) or (rule.start_m, rule.full_m)


def _of_leaf(leaf: Leaf) -> Iterator[_Limits]:
    match leaf:
        case DistanceCondition():
            yield DistanceFigure(leaf.target, leaf.quantity), _finite(leaf)
        case DirectionCondition():
            yield DirectionFigure(leaf.target, leaf.quantity), _finite(leaf)
        case ClosingCondition():
            yield ClosingFigure(leaf.target), _finite(leaf)
        case SeparationCondition():
            yield SeparationFigure(*leaf.targets), _finite(leaf)
        case TimeToContactCondition():
            yield ContactFigure(leaf.target, leaf.contact_m), (leaf.below_s,)
            yield PaceFigure(leaf.target, leaf.closing_min_mps, sigmas_that_count(leaf)), PACE_LIMITS
        case PresenceCondition():
            yield PresenceFigure(leaf.target), (0.5,)
        case CountCondition():
            yield CountFigure(leaf.targets), _counts(leaf)
        case _:
            pass  # other rules and the time of day are no figures


def _finite(leaf: LimitsCondition) -> tuple[float, ...]:
    return tuple(limit for limit in limits_of(leaf) if math.isfinite(limit))


def _counts(leaf: CountCondition) -> tuple[float, ...]:
    """Return limits between the numbers that can be counted."""
    least = () if leaf.at_least is None else (leaf.at_least - 0.5,)
    return least if leaf.at_most is None else (*least, leaf.at_most + 0.5)
