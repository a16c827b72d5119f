"""What is worked out once for the rules of a plan: what they watch, and in which order they are judged."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

from stadimeter.core.condition import depends_on
from stadimeter.core.conditions.verdict import judged_by_cycle
from stadimeter.core.plan import BaseOutput, Output, Plan
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.rules.quiescence import Watch, watch_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """Which rules ask for which.

    Attributes:
        rank: For each rule its place in the order of judging; empty where no rule asks for another.
        askers: For each rule that is asked for, by its position in the plan, the positions of those who ask.
    """

    rank: tuple[int, ...] = ()
    askers: Mapping[int, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What is worked out once for a plan.

    Attributes:
        bases: The names of the outputs that are bases.
        combined: The outputs that have equals to combine, by name.
        grouped: The positions of the alarms that belong to a group.
        by_cycle: The positions of the alarms that are judged in every cycle, with or without a new frame.
        positions: The position of each rule, by its name.
    """

    watch: Watch = field(default_factory=Watch)
    order: Order = field(default_factory=Order)
    bases: frozenset[str] = frozenset()
    combined: Mapping[str, Output] = field(default_factory=dict)
    grouped: tuple[int, ...] = ()
    by_cycle: frozenset[int] = frozenset()
    positions: Mapping[str, int] = field(default_factory=dict)


def layout_of(plan: Plan) -> Layout:
    """Work out what the rules of a plan are judged with.

    Raises:
        ValueError: Rules ask for each other in a circle.
    """
    contested = contested_outputs(plan.rules)
    alarms = [(index, rule) for index, rule in enumerate(plan.rules) if isinstance(rule, AlarmRule)]
    return Layout(
        watch=watch_of(plan.rules),
        order=order_of(plan.rules),
        bases=frozenset(output.name for output in plan.outputs if isinstance(output, BaseOutput)),
        combined={output.name: output for output in plan.outputs if output.name in contested},
        grouped=tuple(index for index, rule in alarms if rule.group),
        by_cycle=frozenset(index for index, rule in alarms if judged_by_cycle(rule.condition)),
        positions={rule.name: index for index, rule in enumerate(plan.rules)},
    )


def contested_outputs(rules: Sequence[AnyRule]) -> frozenset[str]:
    """Return the outputs that two rules, or more, may ask for with one priority."""
    names: dict[tuple[str, int], set[str]] = defaultdict(set)
    for rule in rules:
        steps = rule.escalation if isinstance(rule, AlarmRule) else ()
        for output in (rule.output, *(step.output for step in steps)):
            if output is not None:
                names[output, rule.priority].add(rule.name)
    return frozenset(output for (output, _), of_one_priority in names.items() if len(of_one_priority) > 1)


def asks_for(rule: AnyRule) -> frozenset[str]:
    """Return the names of the rules that a rule asks for, by its condition or by what suppresses it."""
    if not isinstance(rule, AlarmRule):
        return frozenset()
    suppressing = depends_on(rule.suppress_when) if rule.suppress_when is not None else frozenset()
    return depends_on(rule.condition) | suppressing


def order_of(rules: Sequence[AnyRule]) -> Order:
    """Return in which order rules are judged. Those that do not depend on each other stay in the order of the plan.

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
