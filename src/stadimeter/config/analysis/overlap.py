"""The spans of one figure where a condition holds, or a rule acts: they tell that two never meet, or always.

It looks at limits, deadbands and whether a target is in sight. What is made of others with `any` or `not`, and
schedules, may meet everything: nothing is said of these.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from msgspec import Struct

from stadimeter.config.rules.compiled import WrittenCondition
from stadimeter.core.conditions.compounds import AllOf, Condition
from stadimeter.core.conditions.discrete import PresenceCondition
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.rule import ALWAYS, AlarmRule, AnyRule, FollowRule, RampRule, gate_of

IN_SIGHT = "in sight"


class Span(Struct, frozen=True):
    """A stretch where something holds. Ends do not count: no measurement is exactly at a threshold.

    Attributes:
        figure: Such as ``("distance", "ball")``. The figure ``("in sight", TARGET)`` is for how many seconds the
            target has been in sight, and below zero for how many it has been lost.
        low: In its unit.
        sights: The targets that must be in sight.
        deadband: How far each limit moves once it holds, standard deviations left out.
    """

    figure: tuple[str, ...]
    low: float
    high: float
    sights: tuple[str, ...] = ()
    deadband: float = 0.0

    @property
    def is_empty(self) -> bool:
        """True if nothing is in it."""
        return self.low >= self.high

    def meets(self, other: Span) -> bool:
        """Check whether both may hold at once."""
        if self.figure == other.figure:
            return max(self.low, other.low) < min(self.high, other.high)
        return not (self._is_blind_to(other) or other._is_blind_to(self))

    def covers(self, other: Span) -> bool:
        """Check whether it holds wherever another one does: where they begin, and where they end."""
        if self.figure[0] == IN_SIGHT and self.low == 0.0 and self.figure[1] in other.sights:
            return True
        is_wide = self.low <= other.low and self.high >= other.high
        stays = self.low - self.deadband <= other.low - other.deadband
        return self.figure == other.figure and is_wide and stays and (
            self.high + self.deadband >= other.high + other.deadband
        )  # fmt: skip

    def _is_blind_to(self, other: Span) -> bool:
        return self.figure[0] == IN_SIGHT and self.high <= 0 and self.figure[1] in other.sights


def span_of(condition: Condition) -> Span | None:
    """Return where a simple condition holds; None for one of which nothing is said."""
    if isinstance(condition, PresenceCondition):
        limits = (condition.for_s, math.inf) if condition.seen else (-math.inf, -condition.for_s)
        return Span((IN_SIGHT, condition.target), *limits)
    if not isinstance(condition, Leaf) or not condition.has_figures:
        return None
    low, high = condition.limits
    if isinstance(condition, FigureCondition) and condition.is_comparison and condition.target > condition.other:
        low, high = -high, -low  # one figure for both directions
    targets = tuple(sorted(condition.targets_named))
    return Span(
        (condition.noun, *targets),
        low if condition.is_signed else max(low, 0.0),
        high,
        targets,
        condition.deadband if isinstance(condition, LimitsCondition) else 0.0,
    )


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
