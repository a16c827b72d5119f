"""An output that grows with distance, or with nearness."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.decision import RuleStatus
from stadimeter.core.plan import RampRule
from stadimeter.core.rules.conditions import no_figures, quantity_of
from stadimeter.core.rules.request import LevelRequest
from stadimeter.core.rules.step import Step, trace_of
from stadimeter.core.rules.words import metres
from stadimeter.core.track import Track

HOLD_ON_SIGMAS = 2.0
"""An output that has begun goes on until the target is this far back: noise at the start must not switch it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RampStep(Step):
    """What a ramp does in one cycle.

    Attributes:
        level: The level that it gives; above zero, it holds on to noise.
    """

    level: float = 0.0


def new_ramp(rule: RampRule) -> RampStep:
    """Return a ramp at the start of a run.

    Args:
        rule: The ramp.

    Returns:
        Its step before the first cycle.
    """
    return RampStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def ramp_level(rule: RampRule, value_m: float, sigma_m: float, *, is_on: bool) -> float:
    """Return the level that a ramp gives.

    With u the share of the way from start to full, limited to 0…1: 0 where u = 0, else min + u^gamma · (max − min).

    Args:
        rule: The ramp.
        value_m: Distance or depth.
        sigma_m: Its standard deviation.
        is_on: Whether the output is above zero now.

    Returns:
        From 0 to 1.
    """
    span_m = rule.full_m - rule.start_m
    towards_full_m = math.copysign(sigma_m, span_m)
    if rule.bias == "cautious":
        value_m += towards_full_m
    elif rule.bias == "quiet":
        value_m -= towards_full_m
    share = (value_m - rule.start_m) / span_m
    if share <= 0:
        is_near_start = is_on and -share * abs(span_m) < HOLD_ON_SIGMAS * sigma_m
        return rule.level_min if is_near_start else 0.0
    return rule.level_min + math.pow(min(share, 1.0), rule.gamma) * (rule.level_max - rule.level_min)


def step_ramp(rule: RampRule, before: RampStep, track: Track) -> RampStep:
    """Judge a ramp for one cycle.

    Args:
        rule: The ramp.
        before: Its step in the cycle before.
        track: Its target.

    Returns:
        What it does.
    """
    figures = quantity_of(track, rule.quantity)
    if figures is None:
        return _step(rule, before, RuleStatus.UNKNOWN, 0.0, rests=True)
    level = ramp_level(rule, *figures, is_on=before.level > 0)
    status = RuleStatus.ACTIVE if level > 0 else RuleStatus.IDLE
    return _step(rule, before, status, level, rests=_rests(rule, figures[0], level))


def why(rule: RampRule, track: Track) -> str:
    """Return why a ramp does what it does, in words with figures.

    Args:
        rule: The ramp.
        track: Its target.

    Returns:
        The words.
    """
    figures = quantity_of(track, rule.quantity)
    if figures is None:
        return no_figures(track)
    return f"{metres(*figures)} between {rule.start_m:.2f} m (off) and {rule.full_m:.2f} m (full)"


def _step(rule: RampRule, before: RampStep, status: RuleStatus, level: float, *, rests: bool) -> RampStep:
    if status is before.trace.status and level == before.level and rests is before.rests:
        return before
    request = None
    if rule.output is not None and level > 0:
        request = LevelRequest(rule=rule.name, output=rule.output, priority=rule.priority, level=level)
    trace = trace_of(rule, status, before.trace)
    return RampStep(trace=trace, request=request, rests=rests, level=level)


def _rests(rule: RampRule, value_m: float, level: float) -> bool:
    """Return whether the level stays until the distance crosses an end of the ramp: all the way off, or full."""
    if rule.bias != "neutral":  # then the standard deviation counts too
        return False
    share = (value_m - rule.start_m) / (rule.full_m - rule.start_m)
    return (share < 0 and level == 0) or share > 1
