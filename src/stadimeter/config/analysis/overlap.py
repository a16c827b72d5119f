"""The spans of one figure where a condition holds, or a rule acts: they tell that two never meet, or always.

It looks at limits, deadbands and whether a target is in sight. What is made of others with `any` or `not`, and
schedules, may meet everything: nothing is said of these.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from stadimeter.config.rules.compiled import WrittenCondition
from stadimeter.core.conditions.compounds import AllOf, Condition
from stadimeter.core.conditions.leaf import IN_SIGHT, Leaf, Span
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.rule import ALWAYS, AlarmRule, AnyRule, FollowRule, RampRule, gate_of


def span_of(condition: Condition) -> Span | None:
    """Return where a simple condition holds; None for one of which nothing is said."""
    return condition.span if isinstance(condition, Leaf) else None


def range_of(rule: AnyRule) -> Span | None:
    """Return where a rule would act if its gate were open; None where that is no single span."""
    if isinstance(rule, AlarmRule):
        return span_of(rule.condition)
    if isinstance(rule, FollowRule):
        return Span((IN_SIGHT, rule.target), 0.0, math.inf)
    if not isinstance(rule, RampRule) or rule.points:
        return None
    begins = _begins(rule)
    low, high = (begins, math.inf) if rule.full > rule.start else (-math.inf, begins)
    return span_of(FigureCondition(quantity=rule.quantity, above=low, below=high, target=rule.target))


def is_always_open(rule: AnyRule) -> bool:
    """Check whether nothing but its range keeps a rule from acting."""
    gate = gate_of(rule)
    return gate.suppress_when is None and (isinstance(rule, AlarmRule) or gate.condition is ALWAYS)


def parts_of_all(written: WrittenCondition) -> Iterator[WrittenCondition]:
    """Yield the conditions that must hold together: a condition itself, or the parts of an `all`."""
    if not isinstance(written.condition, AllOf):
        yield written
        return
    for part in written.parts():
        yield from parts_of_all(part)


def _begins(ramp: RampRule) -> float:
    """Return where the level comes out of the dead zone."""
    if ramp.dead_zone <= ramp.level_min:
        return ramp.start
    if ramp.dead_zone >= ramp.level_max:
        return ramp.full
    share = math.pow((ramp.dead_zone - ramp.level_min) / (ramp.level_max - ramp.level_min), 1 / ramp.gamma)
    return ramp.start + share * (ramp.full - ramp.start)
