"""How far two targets are from each other. Unknown while either is out of sight."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.conditions.figures import Uncertain, separation_of
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.leaf import Figure
from stadimeter.core.conditions.limits import LimitsCondition, ends_of, value_of


@dataclass(frozen=True, slots=True, kw_only=True)
class SeparationCondition(LimitsCondition):
    """How far two targets are from each other.

    Attributes:
        above_m: Holds when they are further apart than this; None for no such threshold.
        below_m: Holds when they are nearer to each other than this.
        deadband_m: How far they must come back before the condition ends.
        deadband_sigmas: The same in standard deviations of the noise; the larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
    """

    targets: tuple[str, str]
    above_m: float | None = None
    below_m: float | None = None
    deadband_m: float = 0.0
    deadband_sigmas: float = 3.0
    probability_on: float | None = 0.7
    probability_off: float = 0.5

    unit = "m"
    noun = "separation"

    @property
    def targets_named(self) -> tuple[str, ...]:
        """The two."""
        return self.targets

    @property
    def limits(self) -> tuple[float, float]:
        """In metres; infinite where there is none."""
        return ends_of(self.above_m, self.below_m)

    @property
    def deadband(self) -> float:
        """In metres."""
        return self.deadband_m

    @property
    def figure(self) -> Figure:
        """The distance of the two from each other."""
        return Figure(_separation_m, self.targets)

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the separation; see `LimitsCondition.uncertain`."""
        first, second = self.targets
        return separation_of(inputs.tracks[first], inputs.tracks[second])


def _separation_m(inputs: RuleInputs, first: str, second: str) -> float:
    return value_of(separation_of(inputs.tracks[first], inputs.tracks[second]))
