"""Keep a base at a distance from its target, and pointed at it.

A proportional law: v = k·(d − d₀)·max(0, cos β) and ω = −k_β·β, where d is the distance, d₀ the one to keep and β the
bearing, positive to the right. Vision is late, and a late loop with too much gain swings: with a delay D the gain k
should stay near 0.35 / D. The cosine slows the base while it still has to turn.
"""

from __future__ import annotations

import math

from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.core.plan import FollowRule
from stadimeter.core.rules.conditions import quantity_of
from stadimeter.core.rules.request import TwistRequest
from stadimeter.core.rules.words import metres
from stadimeter.core.track import Track


def follow_twist(rule: FollowRule, distance_m: float, bearing_rad: float) -> tuple[float, float]:
    """Return how to move.

    Args:
        rule: The rule.
        distance_m: Distance to the target.
        bearing_rad: Its bearing, positive to the right.

    Returns:
        Speed forwards in m/s and rate of turn in rad/s, positive to the left, within the rule's limits.
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


def step_follow(rule: FollowRule, track: Track) -> tuple[TwistRequest | None, RuleTrace]:
    """Judge a follow rule for one cycle. It remembers nothing.

    Args:
        rule: The rule.
        track: Its target.

    Returns:
        What it wants of its base, None if nothing; and why.
    """
    figures = quantity_of(track, "distance")
    if figures is None or track.bearing_rad is None or not math.isfinite(track.bearing_rad) or rule.output is None:
        reason = f"{track.target} is {track.status.value}: {track.reason or 'no distance'}"
        return None, RuleTrace(rule=rule.name, status=RuleStatus.UNKNOWN, reason=reason, output=rule.output)
    distance_m, sigma_m = figures
    linear_mps, angular_radps = follow_twist(rule, distance_m, track.bearing_rad)
    reason = (
        f"{metres(distance_m, sigma_m)} at {math.degrees(track.bearing_rad):+.0f}°, "
        f"to keep {rule.distance_m:.2f} m ahead"
    )
    request = TwistRequest(
        rule=rule.name,
        output=rule.output,
        priority=rule.priority,
        linear_mps=linear_mps,
        angular_radps=angular_radps,
        reason=reason,
    )
    status = RuleStatus.ACTIVE if (linear_mps, angular_radps) != (0.0, 0.0) else RuleStatus.IDLE
    return request, RuleTrace(rule=rule.name, status=status, reason=reason, output=rule.output)
