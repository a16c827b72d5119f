"""What is worked out once for the rules of a plan, and not in every cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from stadimeter.core.conditions import verdict as conditions
from stadimeter.core.conditions.crossings import Crossings, crossings_of
from stadimeter.core.plan import BaseOutput, Output, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.core.rules.order import Order, order_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What is worked out once for a plan.

    Attributes:
        crossings: The limits on each figure that rules are judged by.
        order: Which rules ask for which.
        bases: The names of the outputs that are bases.
        combined: The outputs that combine equals, by name.
        grouped: The positions of the alarms that belong to a group.
        by_cycle: The positions of the alarms that are judged in every cycle, with or without a new frame.
        positions: The position of each rule, by its name.
    """

    crossings: tuple[Crossings, ...] = ()
    order: Order = field(default_factory=Order)
    bases: frozenset[str] = frozenset()
    combined: Mapping[str, Output] = field(default_factory=dict)
    grouped: tuple[int, ...] = ()
    by_cycle: frozenset[int] = frozenset()
    positions: Mapping[str, int] = field(default_factory=dict)


def layout_of(plan: Plan) -> Layout:
    """Work out what the rules of a plan are judged with.

    Args:
        plan: The plan.

    Returns:
        The layout.

    Raises:
        ValueError: Rules ask for each other in a circle.
    """
    alarms = [(index, rule) for index, rule in enumerate(plan.rules) if isinstance(rule, AlarmRule)]
    return Layout(
        crossings=crossings_of(plan.rules),
        order=order_of(plan.rules),
        bases=frozenset(output.name for output in plan.outputs if isinstance(output, BaseOutput)),
        combined={output.name: output for output in plan.outputs if output.combine is not None},
        grouped=tuple(index for index, rule in alarms if rule.group),
        by_cycle=frozenset(index for index, rule in alarms if conditions.judged_by_cycle(rule.condition)),
        positions={rule.name: index for index, rule in enumerate(plan.rules)},
    )
