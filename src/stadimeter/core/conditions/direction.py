"""In which direction a target is. How sure a direction is, is not known: the figures alone are compared."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

from stadimeter.core.conditions.figures import Direction, Uncertain, direction_of
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.intervals import Box, Truth
from stadimeter.core.conditions.leaf import Band, Figure
from stadimeter.core.conditions.limits import LimitsCondition, back_said, ends_of, moved, value_of, within_said


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectionCondition(LimitsCondition):
    """In which direction the target is.

    Attributes:
        quantity: Bearing, positive to the right, or elevation, positive upwards.
        above_rad: Holds above this; None for no such threshold.
        below_rad: Holds below this. With both, it holds between them.
        deadband_rad: How far the target must come back before the condition ends.
        target: The target; empty for that of the rule.
    """

    quantity: Direction = "bearing"
    above_rad: float | None = None
    below_rad: float | None = None
    deadband_rad: float = 0.02
    target: str = ""

    unit = "rad"
    uncounted = "; how sure a direction is, is not known"

    @property
    def noun(self) -> str:
        """Bearing or elevation."""
        return self.quantity

    @property
    def limits(self) -> tuple[float, float]:
        """In radians; infinite where there is none."""
        return ends_of(self.above_rad, self.below_rad)

    @property
    def figure(self) -> Figure:
        """The bearing or the elevation of its target."""
        return Figure(_direction_rad, (self.target, self.quantity))

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the angle; see `LimitsCondition.uncertain`."""
        return direction_of(inputs.tracks[self.target], self.quantity)

    def chances(self) -> tuple[float | None, float]:
        """Return that the figures alone are compared."""
        return None, 0.5

    def deadband_at(self, noise: float) -> float:  # noqa: ARG002 - it is not known
        """Return the deadband in radians."""
        return self.deadband_rad

    def said(self, value: float, sigma: float) -> str:  # noqa: ARG002 - it is not known
        """Return an angle in words."""
        return f"{self.quantity} {math.degrees(value):+.1f}°"

    def begins(self) -> str:
        """Return a clause that says when it begins."""
        return f"the {self.quantity} of `{self.target}` is {within_said(self.limits, _degrees, 'below ', 'above ')}"

    def ends(self) -> str:
        """Return a clause that says when it has ended."""
        back = back_said(self.limits, _degrees, "below ", "above ", band=(self.deadband_rad, 0.0, ""))
        return f"its {self.quantity} is {back}"

    def band(self) -> Band:
        """Return its thresholds in degrees, for `check`."""
        scale = 180 / math.pi
        low, high = (None if end is None else end * scale for end in (self.above_rad, self.below_rad))
        return Band(self.quantity, low, high, "deg", self.deadband_rad * scale)

    def widened(self) -> Self:
        """Return it with each threshold moved by its deadband."""
        above_rad, below_rad = moved(self.above_rad, self.below_rad, self.deadband_rad)
        return replace(self, above_rad=above_rad, below_rad=below_rad)

    def situations(self, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:  # noqa: ARG002
        """Yield the boxes of situations in which it is so; see `Leaf.situations`."""
        yield from self.situations_of(truth, self.quantity)


def _direction_rad(inputs: RuleInputs, target: str, quantity: Direction) -> float:
    return value_of(direction_of(inputs.tracks[target], quantity))


def _degrees(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.1f}°"
