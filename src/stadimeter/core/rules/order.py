"""In which order rules are judged: each after those that it asks for."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

from stadimeter.core.condition import depends_on
from stadimeter.core.rule import AlarmRule, AnyRule


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """Which rules ask for which.

    Attributes:
        rank: For each rule its place in the order of judging; empty where no rule asks for another.
        askers: For each rule that is asked for, by its position in the plan, the positions of those who ask.
    """

    rank: tuple[int, ...] = ()
    askers: Mapping[int, tuple[int, ...]] = field(default_factory=dict)


def asks_for(rule: AnyRule) -> frozenset[str]:
    """Return the names of the rules that a rule asks for, by its condition or by what suppresses it.

    Args:
        rule: The rule.

    Returns:
        The names.
    """
    if not isinstance(rule, AlarmRule):
        return frozenset()
    suppressing = depends_on(rule.suppress_when) if rule.suppress_when is not None else frozenset()
    return depends_on(rule.condition) | suppressing


def order_of(rules: Sequence[AnyRule]) -> Order:
    """Return in which order rules are judged.

    Args:
        rules: The rules, in the order of the plan.

    Returns:
        The order. Rules that do not depend on each other stay in the order of the plan.

    Raises:
        ValueError: Rules ask for each other in a circle, or for a rule that is not there.
    """
    positions = {rule.name: index for index, rule in enumerate(rules)}
    asked: dict[int, list[int]] = {}
    for index, rule in enumerate(rules):
        names = asks_for(rule)
        if names:
            asked[index] = [_position(name, rule, positions) for name in sorted(names)]
    if not asked:
        return Order()
    sorter = TopologicalSorter({index: asked.get(index, ()) for index in range(len(rules))})
    try:
        sequence = list(sorter.static_order())
    except CycleError as error:
        circle = " → ".join(rules[index].name for index in error.args[1])
        raise ValueError(f"these rules ask for each other in a circle: {circle}") from error
    rank = [0] * len(rules)
    for place, index in enumerate(sequence):
        rank[index] = place
    askers: dict[int, list[int]] = defaultdict(list)
    for index, others in asked.items():
        for other in others:
            askers[other].append(index)
    return Order(rank=tuple(rank), askers={index: tuple(others) for index, others in askers.items()})


def _position(name: str, rule: AnyRule, positions: Mapping[str, int]) -> int:
    if name not in positions:
        raise ValueError(f"rule '{rule.name}' asks for a rule '{name}' that is not there")
    return positions[name]
