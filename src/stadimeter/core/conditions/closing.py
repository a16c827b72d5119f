"""How fast a target comes nearer."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.conditions.figures import Uncertain, closing_of
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.leaf import Figure
from stadimeter.core.conditions.limits import LimitsCondition, ends_of, value_of


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosingCondition(LimitsCondition):
    """How fast the target comes nearer.

    It takes more than for a distance to be sure: a target that was just seen first may move at any speed.

    Attributes:
        above_mps: Holds above this; None for no such threshold. A target that goes away closes at less than nothing.
        below_mps: Holds below this.
        deadband_mps: How far the speed must come back before the condition ends.
        deadband_sigmas: The same in standard deviations; the larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
        target: The target; empty for that of the rule.
    """

    above_mps: float | None = None
    below_mps: float | None = None
    deadband_mps: float = 0.0
    deadband_sigmas: float = 2.0
    probability_on: float | None = 0.95
    probability_off: float = 0.5
    target: str = ""

    unit = "m/s"
    noun = "closing speed"

    @property
    def limits(self) -> tuple[float, float]:
        """In m/s; infinite where there is none."""
        return ends_of(self.above_mps, self.below_mps)

    @property
    def deadband(self) -> float:
        """In m/s."""
        return self.deadband_mps

    @property
    def figure(self) -> Figure:
        """The closing speed of its target."""
        return Figure(_closing_mps, (self.target,))

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the speed; see `LimitsCondition.uncertain`."""
        return closing_of(inputs.tracks[self.target])


def _closing_mps(inputs: RuleInputs, target: str) -> float:
    return value_of(closing_of(inputs.tracks[target]))
