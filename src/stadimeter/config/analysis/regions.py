"""The condition under which a rule wants something of its output."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TypeVar

from msgspec.structs import replace

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, judged_leaves, with_leaves
from stadimeter.core.conditions.discrete import PresenceCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.rule import ALWAYS, AlarmRule, AnyRule, FollowRule, RampRule, ReportRule

_L = TypeVar("_L", bound=Leaf)


def region_of(rule: AnyRule, *, is_winner: bool = False) -> Condition:
    """Return the condition under which a rule begins to want something of its output.

    Args:
        is_winner: Whether it must surely hold, as a rule that takes the output from others. Else it must possibly hold.

    Returns:
        Its condition; where a ramp is above zero; for a rule that follows, that its target is in sight; for
        messages at times, always; of these as far as their gate lets them.
    """
    if isinstance(rule, AlarmRule):
        return rule.condition
    own = range_of(rule, is_winner=is_winner)
    return own if rule.gate.condition is ALWAYS else AllOf(conditions=(rule.gate.condition, own))


def range_of(rule: RampRule | FollowRule | ReportRule, *, is_winner: bool = False) -> Condition:
    """Return the condition under which a rule would act if its gate were open; see `region_of`."""
    if isinstance(rule, RampRule):
        return AnyOf(conditions=tuple(_points(rule, is_winner=is_winner) if rule.points else [_curve(rule)]))
    return ALWAYS if isinstance(rule, ReportRule) else PresenceCondition(seen=True, target=rule.target)


def widened_region_of(rule: AnyRule, *, is_winner: bool = False) -> Condition:
    """Return the condition under which a rule that wants something goes on to.

    Args:
        is_winner: As for `region_of`.

    Returns:
        The same condition, each limit moved by its deadband. Standard deviations are left out: they are not known yet.
    """
    return _widened(region_of(rule, is_winner=is_winner), is_inverted=False)


def beginning_of(condition: Condition) -> Condition:
    """Return when a condition begins, without deadbands: below a ``not`` these delay even the beginning.

    Returns:
        The same condition, in which each part whose end makes the whole begin has its limits moved by its deadband.
    """
    return _widened(condition, is_inverted=True)


def _widened(condition: Condition, *, is_inverted: bool) -> Condition:
    """Return a condition with those parts widened that stand below an odd number of ``not``, or an even one."""
    parts = judged_leaves(condition, (), is_active=False)
    return with_leaves(condition, (widen(it.leaf) if it.is_inverted is is_inverted else it.leaf for it in parts))


def widen(leaf: _L) -> _L:
    """Return a condition with each threshold moved by its deadband, standard deviations left out."""
    match leaf:
        case DistanceCondition():
            above_m, below_m = _moved(leaf.above_m, leaf.below_m, leaf.deadband_m)
            return replace(leaf, above_m=above_m, below_m=below_m)
        case FigureCondition():
            above, below = _moved(leaf.above, leaf.below, leaf.deadband)
            return replace(leaf, above=above, below=below)
        case _:
            return leaf


def _moved(low: float | None, high: float | None, by: float) -> tuple[float | None, float | None]:
    return None if low is None else low - by, None if high is None else high + by


def _curve(ramp: RampRule) -> FigureCondition:
    begins = _begins(ramp)
    grows = ramp.full > ramp.start
    return _between(ramp, begins if grows else None, None if grows else begins)


def _begins(ramp: RampRule) -> float:
    """Return where the level comes out of the dead zone."""
    if ramp.dead_zone <= ramp.level_min:
        return ramp.start
    if ramp.dead_zone >= ramp.level_max:
        return ramp.full
    share = math.pow((ramp.dead_zone - ramp.level_min) / (ramp.level_max - ramp.level_min), 1 / ramp.gamma)
    return ramp.start + share * (ramp.full - ramp.start)


def _points(ramp: RampRule, *, is_winner: bool) -> list[Condition]:
    """Return between which points, and beyond which, the level is above zero: surely, or possibly."""
    least = min if is_winner else max
    ends = [(None, ramp.points[0][0]), *pairwise(at for at, _ in ramp.points), (ramp.points[-1][0], None)]
    levels = [ramp.points[0][1], *(least(pair) for pair in pairwise(level for _, level in ramp.points))]
    levels.append(ramp.points[-1][1])
    return [
        _between(ramp, low, high) for (low, high), level in zip(ends, levels, strict=True) if level > ramp.dead_zone
    ]


def _between(ramp: RampRule, above: float | None, below: float | None) -> FigureCondition:
    return FigureCondition(quantity=ramp.quantity, above=above, below=below, target=ramp.target)
