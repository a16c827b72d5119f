"""The table of a ramp, and how it becomes the core's rule."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from stadimeter.config.models import Section, Share
from stadimeter.config.rules.common import Factor, RuleCommon
from stadimeter.config.units import LengthOrZero
from stadimeter.core import condition, rule

_RAMP = rule.RampRule(name="", target="", start_m=1.0, full_m=2.0)

_OF_A_CURVE = {"start": "from", "full": "to", "min": "min", "max": "max", "gamma": "gamma"}
"""The fields that say what a table of points says by itself, and how they are written."""


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
