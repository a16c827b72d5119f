"""How far two targets are from each other. Unknown while either is out of sight."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

from stadimeter.core.conditions.figures import Uncertain, separation_of
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.intervals import GONE, LENGTHS, SEEN, Box, Truth, interval
from stadimeter.core.conditions.leaf import Band, Figure
from stadimeter.core.conditions.limits import LimitsCondition, back_said, ends_of, moved, surely, value_of, within_said
from stadimeter.core.words import length, metres


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
    uncounted = "; how sure the directions are is not known, and not counted"

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

    def said(self, value: float, sigma: float) -> str:
        """Return a separation with its standard deviation."""
        first, second = self.targets
        return f"{first} and {second} {metres(value, sigma)} apart"

    def _named(self, words: str) -> str:
        return words

    def begins(self) -> str:
        """Return a clause that says when it begins."""
        apart = within_said(self.limits, length, "nearer to each other than ", "further apart than ")
        return surely(f"`{self.targets[0]}` and `{self.targets[1]}` are {apart}", self.probability_on)

    def ends(self) -> str:
        """Return a clause that says when it has ended."""
        band = self.deadband_m, self.deadband_sigmas, self.unit
        back = back_said(self.limits, length, "nearer to each other than ", "further apart than ", band=band)
        return f"they are {back}"

    def band(self) -> Band:
        """Return its thresholds for `check`."""
        return Band(self.noun, self.above_m, self.below_m, self.unit, self.deadband_m, is_positive=True)

    def widened(self) -> Self:
        """Return it with each threshold moved by its deadband."""
        above_m, below_m = moved(self.above_m, self.below_m, self.deadband_m)
        return replace(self, above_m=above_m, below_m=below_m)

    def situations(self, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:  # noqa: ARG002
        """Yield the boxes of situations in which it is so; see `Leaf.situations`."""
        first, second = (("in sight", target) for target in self.targets)
        if truth is Truth.UNKNOWN:
            yield {first: GONE}
            yield {second: GONE}
            return
        inside = interval(self.above_m, self.below_m)
        axis = ("separation", *sorted(self.targets))
        yield {first: SEEN, second: SEEN, axis: LENGTHS & (inside if truth is Truth.TRUE else ~inside)}


def _separation_m(inputs: RuleInputs, first: str, second: str) -> float:
    return value_of(separation_of(inputs.tracks[first], inputs.tracks[second]))
