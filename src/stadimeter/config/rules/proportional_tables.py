"""The tables of ramps and of rules that follow, whose output depends on the distance, and the core's rules of them."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self, TypedDict

from pydantic import AfterValidator, Field, model_validator

from stadimeter.config.models import Section, Share
from stadimeter.config.units import Angle, Length, LengthOrZero, Speed, TurnRate
from stadimeter.core import condition, rule
from stadimeter.core.decision import Severity

_FOLLOW = rule.FollowRule(name="", target="", distance_m=1.0)
_RAMP = rule.RampRule(name="", target="", start_m=1.0, full_m=2.0)

# The fields that say what a table of points says by itself, and how they are written.
_OF_A_CURVE = {"start": "from", "full": "to", "min": "min", "max": "max", "gamma": "gamma"}


Factor = Annotated[float, Field(gt=0)]


class RuleCommon(TypedDict):
    """What every rule of the core has, whatever its kind; see `stadimeter.core.rule.Rule`."""

    name: str
    target: str
    output: str | None
    priority: int
    severity: Severity
    lost: rule.Lost
    observe: bool


class PointTable(Section):
    """One line of a table of levels."""

    at: LengthOrZero
    """The distance, in metres."""
    level: Share
    """The level there."""


def _in_order(points: list[PointTable]) -> list[PointTable]:
    """Refuse points that go to and fro; whether the nearest or the furthest comes first does not matter."""
    steps_m = [after.at - before.at for before, after in pairwise(points)]
    if not (all(step_m > 0 for step_m in steps_m) or all(step_m < 0 for step_m in steps_m)):
        raise ValueError("the points are not in order; write them from the nearest to the furthest, each distance once")
    return points


Points = Annotated[list[PointTable], Field(min_length=2, max_length=100), AfterValidator(_in_order)]


class RampTable(Section):
    """An output that grows with distance or with nearness; see `stadimeter.core.rule.RampRule`."""

    start: Annotated[LengthOrZero | None, Field(alias="from")] = None
    """In metres, written ``from``; where the output begins."""
    full: Annotated[LengthOrZero | None, Field(alias="to")] = None
    """In metres, written ``to``; where it is full."""
    points: Points | None = None
    """A table of distances and levels instead of a curve from start to full."""
    of: condition.Quantity = _RAMP.quantity
    """Whether these are distances or depths along the optical axis."""
    min: Share = _RAMP.level_min
    """The level right after the start."""
    max: Share = _RAMP.level_max
    """The level at the full end and beyond."""
    gamma: Factor = _RAMP.gamma
    """Exponent of the curve."""
    bias: rule.Bias = _RAMP.bias
    """Which way to err within the standard deviation."""
    dead_zone: Share = _RAMP.dead_zone
    """Levels below this are 0."""

    @model_validator(mode="after")
    def _one_way_only(self) -> Self:
        if self.points is None:
            missing = [_OF_A_CURVE[key] for key in ("start", "full") if getattr(self, key) is None]
            if missing:
                raise ValueError(f"'{missing[0]}' is missing; a ramp has from and to, or points")
            return self
        also = [_OF_A_CURVE[key] for key in _OF_A_CURVE if key in self.model_fields_set]
        if also:
            raise ValueError(f"a ramp with points has no '{also[0]}': the points say it all; leave it out")
        return self

    @property
    def ends_m(self) -> tuple[float, float]:
        """Where the output begins and where it is full, in metres; of points, the outer ones."""
        if self.points is None:
            return self.start or 0.0, self.full or 0.0
        first, *_, last = sorted(self.points, key=lambda point: point.at)
        return (first.at, last.at) if last.level >= first.level else (last.at, first.at)

    def to_plan(self, common: RuleCommon) -> rule.RampRule:
        """Return the rule as the core sees it.

        Returns:
            The rule; its points with the nearest first.
        """
        start_m, full_m = self.ends_m
        return rule.RampRule(
            **common,
            start_m=start_m,
            full_m=full_m,
            quantity=self.of,
            level_min=self.min,
            level_max=self.max,
            gamma=self.gamma,
            bias=self.bias,
            points=tuple(sorted((point.at, point.level) for point in self.points or ())),
            dead_zone=self.dead_zone,
        )


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
