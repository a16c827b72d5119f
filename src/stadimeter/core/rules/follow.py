"""Keep a base at a distance from its target, and pointed at it.

A proportional law: v = k·(d − d₀)·max(0, cos β) and ω = −k_β·β, where d is the distance, d₀ the one to keep and β the
bearing, positive to the right. Vision is late, and a late loop with too much gain swings: with a delay D the gain k
should stay near 0.35 / D. The cosine slows the base while it still has to turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.condition_words import describe_unseen
from stadimeter.core.conditions.figures import quantity_of
from stadimeter.core.decision import RuleStatus
from stadimeter.core.rule import FollowRule
from stadimeter.core.rule_step import Step, TwistRequest, trace_of
from stadimeter.core.track import Track
from stadimeter.core.words import metres


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowStep(Step):
    """What a follow rule does in one cycle. It remembers nothing."""


def new_follow(rule: FollowRule) -> FollowStep:
    """Return a follow rule at the start of a run."""
    return FollowStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


# A base does not drive by a distance whose standard deviation is more than this share of it.
UNSURE_SHARE = 0.3


def follow_twist(rule: FollowRule, distance_m: float, bearing_rad: float) -> tuple[float, float]:
    """Return the speed forwards in m/s and the rate of turn in rad/s, positive to the left, within the rule's limits.

    The bearing is positive to the right.
    """
    error_m = distance_m - rule.distance_m
    linear_mps = 0.0
    if abs(error_m) > rule.deadband_m:
        wanted_mps = rule.gain_per_s * error_m * max(0.0, math.cos(bearing_rad))
        linear_mps = min(max(wanted_mps, -rule.reverse_max_mps), rule.linear_max_mps)
    angular_radps = 0.0
    if abs(bearing_rad) > rule.deadband_rad:
        wanted_radps = -rule.turn_gain_per_s * bearing_rad
        angular_radps = min(max(wanted_radps, -rule.angular_max_radps), rule.angular_max_radps)
    return linear_mps + 0.0, angular_radps + 0.0  # adding zero makes -0.0 an ordinary zero


def step_follow(rule: FollowRule, before: FollowStep, track: Track) -> FollowStep:
    """Judge a follow rule for one cycle."""
    figures = _figures(track)
    if figures is None or rule.output is None:
        return FollowStep(trace=trace_of(rule, RuleStatus.UNKNOWN, before.trace))
    distance_m, _, bearing_rad = figures
    linear_mps, angular_radps = follow_twist(rule, distance_m, bearing_rad)
    request = TwistRequest(
        rule=rule.name,
        output=rule.output,
        priority=rule.priority,
        linear_mps=linear_mps,
        angular_radps=angular_radps,
    )
    requests = () if rule.observe else (request,)
    status = RuleStatus.ACTIVE if (linear_mps, angular_radps) != (0.0, 0.0) else RuleStatus.IDLE
    return FollowStep(trace=trace_of(rule, status, before.trace), requests=requests)


def why(rule: FollowRule, track: Track) -> str:
    """Return why a follow rule does what it does, in words with figures."""
    figures = _figures(track)
    if figures is None:
        distance = quantity_of(track, "distance")
        return f"{metres(*distance[:2])} is too unsure to drive by" if distance else describe_unseen(track)
    distance_m, sigma_m, bearing_rad = figures
    where = f"{metres(distance_m, sigma_m)} at {math.degrees(bearing_rad):+.0f}°"
    return f"{where}, to keep {rule.distance_m:.2f} m ahead"


def _figures(track: Track) -> tuple[float, float, float] | None:
    """Return distance, its standard deviation and bearing; None while they cannot be acted on."""
    figures = quantity_of(track, "distance")
    if figures is None or track.bearing_rad is None or not math.isfinite(track.bearing_rad):
        return None
    distance_m, sigma_m, _ = figures
    return None if sigma_m > UNSURE_SHARE * distance_m else (distance_m, sigma_m, track.bearing_rad)
