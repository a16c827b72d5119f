"""An output that grows with distance, or with nearness: along a curve, or by a table of points.

How fast a level may change is a matter of the output (`rise_per_s`, `fall_per_s`), not of the ramp: an output that two
rules drive in turn has one motor, and one answer to how fast that may speed up.
"""

from __future__ import annotations

import math
from bisect import bisect_right

from stadimeter.core.alarms.gate import OPEN, Gate, GatedStep
from stadimeter.core.condition_words import describe_unseen
from stadimeter.core.conditions.distance import distance_figure
from stadimeter.core.conditions.figures import quantity_of
from stadimeter.core.conditions.leaf import UNKNOWN, Rest
from stadimeter.core.decision import RuleStatus
from stadimeter.core.rule import RampRule
from stadimeter.core.rule_step import LevelRequest, trace_of
from stadimeter.core.track import Track
from stadimeter.core.words import metres

# An output that has begun goes on until the target is this far back, in standard deviations of the noise: noise at the
# start must not switch it.
HOLD_ON_SIGMAS = 2.0


class RampStep(GatedStep, frozen=True, kw_only=True):
    """What a ramp does in one cycle."""

    level: float = 0.0
    """The level that it gives, 0 to 1; above zero, it holds on to noise."""


def new_ramp(rule: RampRule) -> RampStep:
    """Return a ramp at the start of a run."""
    return RampStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def step_ramp(rule: RampRule, before: RampStep, track: Track, gate: Gate = OPEN) -> RampStep:
    """Judge a ramp for one cycle; the step before is returned if nothing changed."""
    figures = quantity_of(track, rule.quantity)
    if gate.is_open is False:
        return _step(rule, before, RuleStatus.IDLE, 0.0, gate)
    if figures is None or gate.is_open is None:
        return _step(rule, before, RuleStatus.UNKNOWN, 0.0, gate)
    level = ramp_level(rule, *figures, is_on=before.level > 0)
    return _step(rule, before, RuleStatus.ACTIVE if level > 0 else RuleStatus.IDLE, level, gate)


def rest_of_ramp(rule: RampRule, step: RampStep, track: Track, gate: Gate = OPEN) -> Rest | None:
    """Return for how long a ramp stays at its level; None if it must be judged in every cycle."""
    if gate is OPEN:
        return _rest_of_level(rule, step, track)
    if gate.rest is None or not gate.is_open:
        return gate.rest
    rest = _rest_of_level(rule, step, track)
    return None if rest is None else rest & gate.rest


def _rest_of_level(rule: RampRule, step: RampStep, track: Track) -> Rest | None:
    figures, figure = quantity_of(track, rule.quantity), distance_figure(rule.target, rule.quantity)
    if figures is None:
        return Rest(((figure, UNKNOWN, UNKNOWN),))
    flat = flat_interval_m(rule, figures[0])
    # A level that is only held against noise ends when the noise changes.
    if flat is None or (step.level > 0 and ramp_level(rule, *figures, is_on=False) == 0):
        return None
    return Rest(((figure, *flat),))


def describe_ramp(rule: RampRule, track: Track) -> str:
    """Return why a ramp does what it does, in words with figures."""
    figures = quantity_of(track, rule.quantity)
    if figures is None:
        return describe_unseen(track)
    now = metres(*figures[:2])
    if rule.points:
        (near_m, at_near), (far_m, at_far) = rule.points[0], rule.points[-1]
        table = f"the table from {near_m:.2f} m ({at_near:.0%}) to {far_m:.2f} m ({at_far:.0%})"
        return f"{now}: {ramp_level(rule, *figures, is_on=False):.0%} by {table}"
    return f"{now} between {rule.start_m:.2f} m (off) and {rule.full_m:.2f} m (full)"


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


# The level at a distance


def ramp_level(rule: RampRule, value_m: float, sigma_m: float, noise_m: float, *, is_on: bool) -> float:
    """Return the level that a ramp gives.

    Along the curve, with u the share of the way from start to full, limited to 0…1: 0 where u = 0, else
    min + u^gamma · (max − min). By the table: between two points in proportion, beyond the ends as at the ends. What is
    below the dead zone is 0.

    Args:
        value_m: Distance or depth.
        sigma_m: Its standard deviation; the bias is within that.
        noise_m: The part of that which differs from frame to frame.
        is_on: Whether the output is above zero now.
    """
    if rule.bias == "neutral":
        level = _level(rule, value_m)
    elif rule.bias == "cautious":
        level = max(_levels_within(rule, value_m, sigma_m))
    else:
        level = min(_levels_within(rule, value_m, sigma_m))
    if level > 0 or not is_on:
        return level
    held = max(rule.dead_zone, 0.0 if rule.points else rule.level_min)
    return held if _is_near_start(rule, value_m, sigma_m, noise_m) else 0.0


def flat_interval_m(rule: RampRule, value_m: float) -> tuple[float, float] | None:
    """Return the distances, ends included, between which the level stays as it is at one of them; None if it does not.

    It never does with a bias, since then the standard deviation counts too.
    """
    if rule.bias != "neutral":
        return None
    if rule.points:
        (before_m, before), (after_m, after) = _neighbours(rule, value_m)
    else:
        first_m, last_m = sorted((rule.start_m, rule.full_m))
        before_m = -math.inf if value_m <= first_m else first_m if value_m <= last_m else last_m
        after_m = first_m if value_m <= first_m else last_m if value_m <= last_m else math.inf
        before, after = 0.0, float(math.isfinite(before_m) and math.isfinite(after_m))  # flat beyond both ends
    if before != after or value_m in {before_m, after_m}:
        return None
    return math.nextafter(before_m, math.inf), math.nextafter(after_m, -math.inf)


def _is_near_start(rule: RampRule, value_m: float, sigma_m: float, noise_m: float) -> bool:
    """Return whether noise alone may have taken a target there from where the output begins."""
    reach_m = HOLD_ON_SIGMAS * noise_m + {"neutral": 0.0, "cautious": sigma_m, "quiet": -sigma_m}[rule.bias]
    if reach_m >= 0:
        return max(_levels_within(rule, value_m, reach_m)) > 0
    # A quiet ramp begins well within its range, and gives that up only as far as the noise goes.
    return min(_levels_within(rule, value_m, -reach_m)) > 0


def _level(rule: RampRule, value_m: float) -> float:
    level = _by_table(rule, value_m) if rule.points else _along_curve(rule, value_m)
    return level if level >= rule.dead_zone else 0.0


def _levels_within(rule: RampRule, value_m: float, reach_m: float) -> list[float]:
    """Return the levels among which the least and the greatest within some distance of a value are."""
    near_m, far_m = value_m - reach_m, value_m + reach_m
    between = [at_m for at_m, _ in rule.points if near_m < at_m < far_m]
    return [_level(rule, at_m) for at_m in (near_m, *between, far_m)]


def _along_curve(rule: RampRule, value_m: float) -> float:
    share = (value_m - rule.start_m) / (rule.full_m - rule.start_m)
    if share <= 0:
        return 0.0
    if share >= 1:
        return rule.level_max  # exactly: a sum may be rounded to more, and more than 1 is no level
    level = rule.level_min + math.pow(share, rule.gamma) * (rule.level_max - rule.level_min)
    return min(level, max(rule.level_min, rule.level_max))


def _by_table(rule: RampRule, value_m: float) -> float:
    (before_m, before), (after_m, after) = _neighbours(rule, value_m)
    if before == after:
        return before
    level = before + (after - before) * (value_m - before_m) / (after_m - before_m)
    return min(max(level, min(before, after)), max(before, after))  # whatever was rounded


def _neighbours(rule: RampRule, value_m: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the points around a value; beyond the ends, the same level goes on for ever."""
    index = bisect_right(rule.points, (value_m, math.inf))
    before = rule.points[index - 1] if index > 0 else (-math.inf, rule.points[0][1])
    after = rule.points[index] if index < len(rule.points) else (math.inf, rule.points[-1][1])
    return before, after
