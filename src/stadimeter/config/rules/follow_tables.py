"""The table of a rule that follows a target, and how it becomes the core's rule."""

from __future__ import annotations

from stadimeter.config.models import Section
from stadimeter.config.rules.common import Factor, RuleCommon
from stadimeter.config.units import Angle, Length, LengthOrZero, Speed, TurnRate
from stadimeter.core import rule

_FOLLOW = rule.FollowRule(name="", target="", distance_m=1.0)


class FollowTable(Section):
    """A base that keeps its distance; see `stadimeter.core.rule.FollowRule`."""

    distance: Length
    """In metres."""
    gain: Factor = _FOLLOW.gain_per_s
    """Forward speed for each metre of distance error, in 1/s."""
    turn_gain: Factor = _FOLLOW.turn_gain_per_s
    """Rate of turn for each radian of bearing, in 1/s."""
    max_speed: Speed = _FOLLOW.linear_max_mps
    """In m/s, forwards."""
    max_reverse_speed: Speed = _FOLLOW.reverse_max_mps
    """In m/s, backwards; 0 never reverses."""
    max_turn_rate: TurnRate = _FOLLOW.angular_max_radps
    """In rad/s."""
    deadband: LengthOrZero = _FOLLOW.deadband_m
    """In metres."""
    turn_deadband: Angle = _FOLLOW.deadband_rad
    """In radians."""

    def to_plan(self, common: RuleCommon) -> rule.FollowRule:
        """Return the rule as the core sees it."""
        return rule.FollowRule(
            **common,
            distance_m=self.distance,
            gain_per_s=self.gain,
            turn_gain_per_s=self.turn_gain,
            linear_max_mps=self.max_speed,
            reverse_max_mps=self.max_reverse_speed,
            angular_max_radps=self.max_turn_rate,
            deadband_m=self.deadband,
            deadband_rad=self.turn_deadband,
        )
