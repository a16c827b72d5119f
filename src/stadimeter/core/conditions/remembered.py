"""Conditions on figures that are remembered over a window of time."""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.bounds import MAX_SPEED_MPS
from stadimeter.core.conditions.figures import Uncertain
from stadimeter.core.conditions.leaf import UNKNOWN, Figure, JudgedFigure, RuleInputs
from stadimeter.core.conditions.limits import LimitsCondition, ends_of


class FigureCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """A remembered figure is within thresholds, as it was after the cycle before.

    Attributes:
        figure_name: Its name.
        unit: The SI unit of the thresholds, which is that of the figure.
        above: Holds above this; None for no such threshold.
        below: Holds below this.
        deadband: How far it must come back before the condition ends.
    """

    figure_name: str
    unit: str = "m"
    above: float | None = None
    below: float | None = None
    deadband: float = 0.0

    is_by_cycle = True
    has_figures = False
    section = "figure"
    probability_on = None  # how sure a remembered figure is, is not known
    ends = ("above", "below")
    bounds = (-MAX_SPEED_MPS, MAX_SPEED_MPS)

    @property
    def noun(self) -> str:
        """Its name."""
        return f"figure {self.figure_name}"

    @property
    def targets_named(self) -> tuple[str, ...]:
        """None: it is known though its target is out of sight."""
        return ()

    @property
    def limits(self) -> tuple[float, float]:
        """In the unit; infinite where there is none."""
        return ends_of(self.above, self.below)

    @property
    def figure(self) -> Figure:
        """The figure that it watches."""
        return Figure(_remembered, (self.figure_name,))

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the figure, its standard deviation, which is not known, as 0; see `LimitsCondition.uncertain`."""
        value = inputs.figures.get(self.figure_name)
        return None if value is None else (value, 0.0, 0.0)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:
        """Return the figure, without a standard deviation: that is not known."""
        reading = LimitsCondition.reading(self, inputs, is_on)
        return None if reading is None else replace(reading, sigma=None)


def _remembered(inputs: RuleInputs, name: str) -> float:
    value = inputs.figures.get(name)
    return UNKNOWN if value is None else value
