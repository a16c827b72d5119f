"""In which direction a target is. How sure a direction is, is not known: the figures alone are compared."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stadimeter.core.conditions.figures import Direction, Uncertain, direction_of
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.leaf import Figure, JudgedFigure
from stadimeter.core.conditions.limits import LimitsCondition, ends_of, value_of


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

    @property
    def noun(self) -> str:
        """Bearing or elevation."""
        return self.quantity

    @property
    def limits(self) -> tuple[float, float]:
        """In radians; infinite where there is none."""
        return ends_of(self.above_rad, self.below_rad)

    @property
    def deadband(self) -> float:
        """In radians."""
        return self.deadband_rad

    @property
    def figure(self) -> Figure:
        """The bearing or the elevation of its target."""
        return Figure(_direction_rad, (self.target, self.quantity))

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the angle; see `LimitsCondition.uncertain`."""
        return direction_of(inputs.tracks[self.target], self.quantity)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:
        """Return the angle, without a standard deviation: that is not known."""
        reading = LimitsCondition.reading(self, inputs, is_on)
        return None if reading is None else replace(reading, sigma=None)


def _direction_rad(inputs: RuleInputs, target: str, quantity: Direction) -> float:
    return value_of(direction_of(inputs.tracks[target], quantity))
