"""An output that grows with a figure of its target, such as its nearness: along a curve, or by a table of points.

How fast a level may change is a matter of the output (`rise_per_s`, `fall_per_s`), not of the ramp: an output that two
rules drive in turn has one motor, and one answer to how fast that may speed up.
"""

from __future__ import annotations

import math
from bisect import bisect_right

from stadimeter.core.alarms.alarm import OPEN, Gate, GatedStep
from stadimeter.core.conditions.leaf import RuleInputs, describe_unread
from stadimeter.core.conditions.quantities import QUANTITIES, noun_of, uncertain_of
from stadimeter.core.decision import RuleStatus
from stadimeter.core.rule import LevelRequest, RampRule, trace_of
from stadimeter.core.words import short_figure, uncertain_figure

# An output that has begun goes on until the target is this far back, in standard deviations of the noise: noise at the
# start must not switch it.
HOLD_ON_SIGMAS = 2.0


class RampStep(GatedStep, frozen=True, kw_only=True):
    """The action of a ramp in one cycle."""

    level: float = 0.0
    """The level that it gives, 0 to 1; above zero, it holds on to noise."""


def new_ramp(rule: RampRule) -> RampStep:
    """Return a ramp at the start of a run."""
    return RampStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def step_ramp(rule: RampRule, before: RampStep, inputs: RuleInputs, gate: Gate = OPEN) -> RampStep:
    """Judge a ramp for one cycle; the step before is returned if nothing changed."""
    figures = uncertain_of(inputs, rule.target, rule.quantity)
    if gate.is_open is False:
        return _step(rule, before, RuleStatus.IDLE, 0.0, gate)
    if figures is None or gate.is_open is None:
        return _step(rule, before, RuleStatus.UNKNOWN, 0.0, gate)
    level = ramp_level(rule, *figures, is_on=before.level > 0)
    return _step(rule, before, RuleStatus.ACTIVE if level > 0 else RuleStatus.IDLE, level, gate)


def describe_ramp(rule: RampRule, inputs: RuleInputs) -> str:
    """Return why a ramp does what it does, in words with figures."""
    figures = uncertain_of(inputs, rule.target, rule.quantity)
    if figures is None:
        return describe_unread((inputs.tracks[rule.target],), noun_of(rule.quantity))
    now = uncertain_figure(noun_of(rule.quantity), *figures[:2], QUANTITIES[rule.quantity].unit)
    if rule.points:
        (low, at_low), (high, at_high) = rule.points[0], rule.points[-1]
        table = f"the table from {_at(rule, low)} ({at_low:.0%}) to {_at(rule, high)} ({at_high:.0%})"
        return f"{now}: {ramp_level(rule, *figures, is_on=False):.0%} by {table}"
    return f"{now} between {_at(rule, rule.start)} (off) and {_at(rule, rule.full)} (full)"


def _at(rule: RampRule, value: float) -> str:
    return short_figure(value, QUANTITIES[rule.quantity].unit)


def _step(rule: RampRule, before: RampStep, status: RuleStatus, level: float, gate: Gate) -> RampStep:
    is_same = status is before.trace.status and gate.inhibits == before.trace.inhibits
    is_gate_same = gate.record is None and gate.is_open is before.is_open and gate.held == before.held
    if is_same and level == before.level and is_gate_same:
        return before
    record = before.record if gate.record is None else gate.record
    requests: tuple[LevelRequest, ...] = ()
    if rule.output is not None and level > 0 and not gate.inhibits:
        requests = (LevelRequest(rule=rule.name, output=rule.output, priority=rule.priority, level=level),)
    trace = before.trace if is_same else trace_of(rule, status, before.trace, gate.inhibits)
    return RampStep(trace=trace, requests=requests, level=level, record=record, is_open=gate.is_open, held=gate.held)


# The level at a figure


def ramp_level(rule: RampRule, value: float, sigma: float, noise: float, *, is_on: bool) -> float:
    """Return the level that a ramp gives.

    Along the curve, with u the share of the way from start to full, limited to 0…1: 0 where u = 0, else
    min + u^gamma · (max − min). By the table: between two points in proportion, beyond the ends as at the ends. What is
    below the dead zone is 0.

    Args:
        value: The ramp's quantity, in its SI unit.
        sigma: Its standard deviation; the bias is within that.
        noise: The part of that which differs from frame to frame.
        is_on: Whether the output is above zero now.
    """
    if rule.bias == "neutral":
        level = _level(rule, value)
    elif rule.bias == "cautious":
        level = max(_levels_within(rule, value, sigma))
    else:
        level = min(_levels_within(rule, value, sigma))
    if level > 0 or not is_on:
        return level
    held = max(rule.dead_zone, 0.0 if rule.points else rule.level_min)
    return held if _is_near_start(rule, value, sigma, noise) else 0.0


def _is_near_start(rule: RampRule, value: float, sigma: float, noise: float) -> bool:
    """Check whether noise alone may have taken a target there from where the output begins."""
    reach = HOLD_ON_SIGMAS * noise + {"neutral": 0.0, "cautious": sigma, "quiet": -sigma}[rule.bias]
    if reach >= 0:
        return max(_levels_within(rule, value, reach)) > 0
    # A quiet ramp begins well within its range, and gives that up only as far as the noise goes.
    return min(_levels_within(rule, value, -reach)) > 0


def _level(rule: RampRule, value: float) -> float:
    level = _by_table(rule, value) if rule.points else _along_curve(rule, value)
    return level if level >= rule.dead_zone else 0.0


def _levels_within(rule: RampRule, value: float, reach: float) -> list[float]:
    """Return the levels among which the least and the greatest within some distance of a value are."""
    low, high = value - reach, value + reach
    between = [at for at, _ in rule.points if low < at < high]
    return [_level(rule, at) for at in (low, *between, high)]


def _along_curve(rule: RampRule, value: float) -> float:
    share = (value - rule.start) / (rule.full - rule.start)
    if share <= 0:
        return 0.0
    if share >= 1:
        return rule.level_max  # exactly: a sum may be rounded to more, and more than 1 is no level
    level = rule.level_min + math.pow(share, rule.gamma) * (rule.level_max - rule.level_min)
    return min(level, max(rule.level_min, rule.level_max))


def _by_table(rule: RampRule, value: float) -> float:
    (before_at, before), (after_at, after) = _neighbours(rule, value)
    if before == after:
        return before
    level = before + (after - before) * (value - before_at) / (after_at - before_at)
    return min(max(level, min(before, after)), max(before, after))  # whatever was rounded


def _neighbours(rule: RampRule, value: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the points around a value; beyond the ends, the same level goes on for ever."""
    index = bisect_right(rule.points, (value, math.inf))
    before = rule.points[index - 1] if index > 0 else (-math.inf, rule.points[0][1])
    after = rule.points[index] if index < len(rule.points) else (math.inf, rule.points[-1][1])
    return before, after
