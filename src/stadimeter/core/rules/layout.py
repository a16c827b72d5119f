"""Facts worked out once for the rules of a plan: the order in which they are judged, and what they take."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from graphlib import TopologicalSorter

from msgspec import Struct, field

from stadimeter.core.conditions.compounds import depends_on, judged_by_cycle, leaves
from stadimeter.core.conditions.quantities import motion_of
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.plan import BaseOutput, Output, Plan
from stadimeter.core.rule import AlarmRule, AnyRule, RampRule, conditions_of
from stadimeter.core.tracking.transverse import AskedMotion


class Layout(Struct, frozen=True, kw_only=True):
    """Facts that are worked out once for a plan.

    Attributes:
        order: The positions of the rules in the order of judging: each after those that it asks for.
        asked_for: The positions of the rules that others ask for.
        motions: The motions across the line of sight that any rule takes.
        bases: The outputs that are bases, by name.
        combined: The outputs that have equals to combine, by name.
        grouped: The positions of the alarms that belong to a group.
        by_cycle: The positions of the alarms that are judged in every cycle, with or without a new frame.
        positions: The position of each rule, by its name.
        sequences: For each rule that a sequence names, by its name, the sequences that it is the last of.
    """

    order: tuple[int, ...] = ()
    asked_for: frozenset[int] = frozenset()
    motions: frozenset[AskedMotion] = frozenset()
    bases: Mapping[str, BaseOutput] = field(default_factory=dict)
    combined: Mapping[str, Output] = field(default_factory=dict)
    grouped: tuple[int, ...] = ()
    by_cycle: frozenset[int] = frozenset()
    positions: Mapping[str, int] = field(default_factory=dict)
    sequences: Mapping[str, tuple[SequenceCondition, ...]] = field(default_factory=dict)


def layout_of(plan: Plan) -> Layout:
    """Work out what the rules of a plan are judged with.

    Raises:
        CycleError: Rules ask for each other in a circle; a configuration with such rules is refused before.
    """
    positions = {rule.name: index for index, rule in enumerate(plan.rules)}
    asked = {index: [positions[name] for name in sorted(asks_for(rule))] for index, rule in enumerate(plan.rules)}
    contested = contested_outputs(plan.rules)
    alarms = [(index, rule) for index, rule in enumerate(plan.rules) if isinstance(rule, AlarmRule)]
    return Layout(
        order=tuple(TopologicalSorter(asked).static_order()),  # where none asks, in the order of the plan
        asked_for=frozenset().union(*asked.values()),
        motions=frozenset(each for rule in plan.rules for each in _motions(rule)),
        bases={output.name: output for output in plan.outputs if isinstance(output, BaseOutput)},
        combined={output.name: output for output in plan.outputs if output.name in contested},
        grouped=tuple(index for index, rule in alarms if rule.group),
        by_cycle=frozenset(index for index, rule in alarms if judged_by_cycle(rule.condition)),
        positions=positions,
        sequences=_sequences(plan.rules),
    )


def _motions(rule: AnyRule) -> Iterator[AskedMotion]:
    taken = [leaf.motion for condition in conditions_of(rule) for leaf in leaves(condition)]
    if isinstance(rule, RampRule):
        taken.append(motion_of(rule.target, rule.quantity))
    return (each for each in taken if each is not None)


def _sequences(rules: Sequence[AnyRule]) -> dict[str, tuple[SequenceCondition, ...]]:
    parts = (leaf for rule in rules for condition in conditions_of(rule) for leaf in leaves(condition))
    found = list(dict.fromkeys(part for part in parts if isinstance(part, SequenceCondition)))
    named = {name for each in found for name in each.rules}
    return {name: tuple(each for each in found if each.rules[-1] == name) for name in named}


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
    """Return the names of the rules that a rule asks for, by any of its conditions."""
    return frozenset().union(*map(depends_on, conditions_of(rule)))
