"""Keep a base at a distance from its target, and pointed at it.

With the distance d, the one to keep d₀, and the bearing β, positive to the right:

    v = (u + s(d − d₀)) · max(0, cos β)        ω = −k_β β + (u_left − v sin β) / d

A camera that tilts does so by the same law as the base turns, with the elevation in place of −β.

u and u_left are the target's own speeds, away and across: fed forward, they leave no lag behind a target that walks.
s(e) is k·e near the goal and √(2 a (|e| − a/2k²)) further away: the speed from which the base, braking at a, comes to
rest there. The cosine slows the base while it still has to turn.

A picture is late, and a late loop with too much gain swings: with the delay D from the picture to the wheels, k D
must stay well below 1 (simulated: 0.37 overshoots by 1 %, 0.5 by 10 %, 1.0 by 67 %). So k is 0.35 / D, at most
`MAX_GAIN_PER_S`.
"""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.rule import FollowRule
from stadimeter.core.rules.own_motion import AT_REST, Twist
from stadimeter.core.rules.target_motion import RelativeTarget

# Gain times delay: 0 to 1 % overshoot in the table above. A gain that is stated may be this much at most.
GAIN_SHARE, MAX_GAIN_SHARE = 0.35, 1.0

# With an acceleration of 0.5 m/s² a gain of 2 overshoots by 12 to 22 % however short the delay is: what limits it
# then is how soon the base can brake. It grows with the root of the acceleration.
MAX_GAIN_PER_S, AT_ACCELERATION_MPS2 = 1.5, 0.5
MAX_TURN_GAIN_PER_S = 3.0

# It plans to brake with this share of its acceleration; the rest is for what it could not foresee.
BRAKE_SHARE = 0.8

# A base that stands sets off for a target that moves by itself at this speed, within the deadband too; one that moves
# comes to rest below these. Slower than that few wheels turn.
SET_OFF_MPS, SET_OFF_RADPS = 0.05, 0.08
REST_MPS, REST_RADPS = 0.02, 0.03

# Nearer than this share of the distance to keep, it stops as hard as it can, and does not ease.
TOO_NEAR = 0.5


class Law(Struct, frozen=True, kw_only=True):
    """The gains of a follow rule for the delay that there is.

    Attributes:
        gain_per_s: Speed for each metre.
        turn_gain_per_s: Rate of turn for each radian.
        brake_mps2: How hard it plans to brake.
    """

    gain_per_s: float = MAX_GAIN_PER_S
    turn_gain_per_s: float = MAX_GAIN_PER_S
    brake_mps2: float = BRAKE_SHARE * AT_ACCELERATION_MPS2


def law_of(rule: FollowRule, delay_s: float, acceleration_mps2: float) -> Law:
    """Return the gains for a delay from the picture to the wheels."""

    def gain(stated: float | None, largest: float) -> float:
        if stated is not None:
            return min(stated, MAX_GAIN_SHARE / delay_s)
        return min(GAIN_SHARE / delay_s, largest)

    largest = MAX_GAIN_PER_S * math.sqrt(acceleration_mps2 / AT_ACCELERATION_MPS2)
    return Law(
        gain_per_s=gain(rule.gain_per_s, largest),
        turn_gain_per_s=gain(rule.turn_gain_per_s, MAX_TURN_GAIN_PER_S),
        brake_mps2=BRAKE_SHARE * acceleration_mps2,
    )


def follow_twist(rule: FollowRule, seen: RelativeTarget, law: Law, before: Twist = AT_REST) -> Twist:
    """Return the speed forwards in m/s and the rate of turn in rad/s, positive to the left, within the rule's limits.

    Args:
        before: The command of the cycle before; a base that moves stays in motion nearer to its goal than one that
            stands is set in motion.
    """
    linear_mps = _linear_mps(rule, seen, law, is_moving=before[0] != 0.0)
    angular_radps = _angular_radps(rule, seen, law, before)
    return linear_mps + 0.0, angular_radps + 0.0  # adding zero makes -0.0 an ordinary zero


def _linear_mps(rule: FollowRule, seen: RelativeTarget, law: Law, *, is_moving: bool) -> float:
    error_m = seen.distance_m - rule.distance_m
    is_near = abs(error_m) <= rule.deadband_m
    wanted_mps = (seen.away_mps + closing_speed_mps(error_m, law)) * max(0.0, math.cos(seen.bearing_rad))
    if is_near and (abs(wanted_mps) < REST_MPS if is_moving else abs(seen.away_mps) < SET_OFF_MPS):
        return 0.0
    return min(max(wanted_mps, -rule.reverse_max_mps), rule.linear_max_mps)


def _angular_radps(rule: FollowRule, seen: RelativeTarget, law: Law, before: Twist) -> float:
    # The line of sight turns as the target crosses it, and as the base drives past the target.
    across_mps = seen.left_mps - before[0] * math.sin(seen.bearing_rad)
    return _turn_radps(rule, seen, law, (-seen.bearing_rad, across_mps), is_turning=before[1] != 0.0)


def tilt_rate_radps(rule: FollowRule, seen: RelativeTarget, law: Law, before_radps: float) -> float:
    """Return the tilt rate of a camera, positive upwards, within the rule's limit; it tilted at some rate before."""
    return _turn_radps(rule, seen, law, (seen.elevation_rad, seen.rising_mps), is_turning=before_radps != 0.0) + 0.0


def _turn_radps(
    rule: FollowRule, seen: RelativeTarget, law: Law, off: tuple[float, float], *, is_turning: bool
) -> float:
    """Return a rate for a target that is off by an angle, and moves across the line of sight in that direction."""
    off_rad, across_mps = off
    ahead_radps = across_mps / max(seen.distance_m, rule.distance_m * TOO_NEAR)
    wanted_radps = ahead_radps + law.turn_gain_per_s * off_rad
    is_near = abs(off_rad) <= rule.deadband_rad
    if is_near and (abs(wanted_radps) < REST_RADPS if is_turning else abs(ahead_radps) < SET_OFF_RADPS):
        return 0.0
    return min(max(wanted_radps, -rule.angular_max_radps), rule.angular_max_radps)


def closing_speed_mps(error_m: float, law: Law) -> float:
    """Return the speed towards the distance to keep from which the base can still come to rest there."""
    bend_m = law.brake_mps2 / law.gain_per_s**2 if law.gain_per_s > 0 else math.inf
    if abs(error_m) <= bend_m:
        return law.gain_per_s * error_m
    return math.copysign(math.sqrt(2 * law.brake_mps2 * (abs(error_m) - bend_m / 2)), error_m)
