"""Which rules a movement of the target concerns: those with a limit on its way, found by bisection."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from stadimeter.core.plan import AlarmRule, AnyRule, DistanceCondition, Quantity, RampRule


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossings:
    """The limits of all rules that are judged by one figure.

    Attributes:
        target: The target.
        quantity: Which of its figures: distance or depth.
        limits_m: The limits, smallest first.
        owners: For each limit, the position of its rule in the plan.
        all_owners: The positions of all these rules.
    """

    target: str
    quantity: Quantity
    limits_m: tuple[float, ...]
    owners: tuple[int, ...]
    all_owners: tuple[int, ...]

    def between(self, before_m: float, now_m: float) -> tuple[int, ...]:
        """Return the rules that a change of the figure concerns.

        Args:
            before_m: The figure before; NaN if it was not known.
            now_m: The figure now.

        Returns:
            The positions of the rules with a limit on the way; of all rules, if the figure came or went.
        """
        if math.isnan(before_m) or math.isnan(now_m):
            is_unknown_still = math.isnan(before_m) and math.isnan(now_m)
            return () if is_unknown_still else self.all_owners
        first = bisect_left(self.limits_m, min(before_m, now_m))
        return self.owners[first : bisect_right(self.limits_m, max(before_m, now_m))]


def crossings_of(rules: Sequence[AnyRule]) -> tuple[Crossings, ...]:
    """Return the limits of rules, sorted.

    Args:
        rules: The rules, in the order of the plan.

    Returns:
        One for each figure that any rule is judged by.
    """
    owners: dict[tuple[str, Quantity], list[int]] = defaultdict(list)
    for index, rule in enumerate(rules):
        owners[rule.target, _quantity(rule)].append(index)
    return tuple(_crossings(rules, target, quantity, indices) for (target, quantity), indices in owners.items())


def _crossings(rules: Sequence[AnyRule], target: str, quantity: Quantity, owners: list[int]) -> Crossings:
    limits = sorted((limit_m, index) for index in owners for limit_m in _limits_m(rules[index]))
    return Crossings(
        target=target,
        quantity=quantity,
        limits_m=tuple(limit_m for limit_m, _ in limits),
        owners=tuple(index for _, index in limits),
        all_owners=tuple(owners),
    )


def _quantity(rule: AnyRule) -> Quantity:
    if isinstance(rule, AlarmRule):
        return rule.condition.quantity if isinstance(rule.condition, DistanceCondition) else "distance"
    return rule.quantity if isinstance(rule, RampRule) else "distance"


def _limits_m(rule: AnyRule) -> tuple[float, ...]:
    if isinstance(rule, RampRule):
        return rule.start_m, rule.full_m
    if isinstance(rule, AlarmRule) and isinstance(rule.condition, DistanceCondition):
        limits_m = rule.condition.above_m, rule.condition.below_m
        return tuple(limit_m for limit_m in limits_m if limit_m is not None)
    return ()
