"""An output that grows with distance, or with nearness."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.core.plan import RampRule
from stadimeter.core.rules.conditions import quantity_of
from stadimeter.core.rules.request import LevelRequest
from stadimeter.core.rules.words import metres
from stadimeter.core.track import Track

HOLD_ON_SIGMAS = 2.0
"""An output that has begun goes on until the target is this far back: noise at the start must not switch it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RampState:
    """What a ramp remembers.

    Attributes:
        is_on: Whether its output is above zero.
    """

    is_on: bool = False


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


def step_ramp(rule: RampRule, state: RampState, track: Track) -> tuple[RampState, LevelRequest | None, RuleTrace]:
    """Judge a ramp for one cycle.

    Args:
        rule: The ramp.
        state: What it remembers.
        track: Its target.

    Returns:
        What it remembers now; what it wants of its output, None if nothing; and why.
    """
    figures = quantity_of(track, rule.quantity)
    if figures is None:
        reason = f"{track.target} is {track.status.value}: {track.reason or 'no distance'}"
        return RampState(), None, _trace(rule, RuleStatus.UNKNOWN, reason)
    value_m, sigma_m = figures
    level = ramp_level(rule, value_m, sigma_m, is_on=state.is_on)
    reason = f"{metres(value_m, sigma_m)} between {rule.start_m:.2f} m (off) and {rule.full_m:.2f} m (full)"
    if level <= 0:
        return RampState(), None, _trace(rule, RuleStatus.IDLE, reason)
    trace = _trace(rule, RuleStatus.ACTIVE, reason)
    if rule.output is None:
        return RampState(is_on=True), None, trace
    request = LevelRequest(rule=rule.name, output=rule.output, priority=rule.priority, level=level, reason=reason)
    return RampState(is_on=True), request, trace


def _trace(rule: RampRule, status: RuleStatus, reason: str) -> RuleTrace:
    return RuleTrace(rule=rule.name, status=status, reason=reason, output=rule.output)
