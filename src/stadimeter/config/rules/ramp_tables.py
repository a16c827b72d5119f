"""The table of a ramp and of its points, and what the core has of it.

Annotations are no texts here, as in every file of tables.
"""

from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from stadimeter.config.models import Section, Share
from stadimeter.config.rules.action_tables import Factor, RuleCommon
from stadimeter.config.rules.figure_tables import WrittenFigure, parse_figure
from stadimeter.core import rule
from stadimeter.core.conditions.quantities import QuantityName

_RAMP = rule.RampRule(name="", target="", start=1.0, full=2.0)

# The fields that say what a table of points says by itself, and how they are written.
_OF_A_CURVE = {"start": "from", "full": "to", "min": "min", "max": "max", "gamma": "gamma"}


class PointTable(Section):
    """One line of a table of levels."""

    at: WrittenFigure
    """The figure, as it is written."""
    level: Share
    """The level there."""


def _check_order(points: list[tuple[float, float]]) -> None:
    """Refuse points that go to and fro; whether the nearest or the furthest comes first does not matter."""
    steps = [after - before for (before, _), (after, _) in pairwise(points)]
    if not (all(step > 0 for step in steps) or all(step < 0 for step in steps)):
        raise ValueError("the points are not in order; write them from the nearest to the furthest, each distance once")


class RampTable(Section):
    """An output that grows with a figure, such as distance or nearness; see `stadimeter.core.rule.RampRule`."""

    of: QuantityName = _RAMP.quantity
    """What it goes by; the figures are written in its units."""
    start: Annotated[WrittenFigure | None, Field(alias="from")] = None
    """Written ``from``; where the output begins."""
    full: Annotated[WrittenFigure | None, Field(alias="to")] = None
    """Written ``to``; where it is full."""
    points: Annotated[list[PointTable], Field(min_length=2, max_length=100)] | None = None
    """A table of figures and levels instead of a curve from start to full."""
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

    @field_validator("start", "full", mode="before")
    @classmethod
    def _fits(cls, value: object, info: ValidationInfo) -> object:
        if value is not None and "of" in info.data:
            parse_figure(value, info.data["of"])
        return value

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
        _check_order(self.levels)
        return self

    @property
    def levels(self) -> list[tuple[float, float]]:
        """The points as they are written: figures in the SI unit, and levels; none for a curve."""
        return [(parse_figure(point.at, self.of), point.level) for point in self.points or ()]

    @property
    def ends(self) -> tuple[float, float]:
        """Where the output begins and where it is full, in the SI unit; of points, the outer ones."""
        if self.points is None:
            return parse_figure(self.start, self.of), parse_figure(self.full, self.of)
        (first, at_first), *_, (last, at_last) = sorted(self.levels)
        return (first, last) if at_last >= at_first else (last, first)

    def to_plan(self, common: RuleCommon) -> rule.RampRule:
        """Return the rule as the core sees it.

        Returns:
            The rule; its points with the least figure first.
        """
        start, full = self.ends
        return rule.RampRule(
            **common,
            start=start,
            full=full,
            quantity=self.of,
            level_min=self.min,
            level_max=self.max,
            gamma=self.gamma,
            bias=self.bias,
            points=tuple(sorted(self.levels)),
            dead_zone=self.dead_zone,
        )
