"""How many targets are in sight."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.leaf import Figure, JudgedFigure, Leaf, Rest
from stadimeter.core.conditions.limits import ends_of


@dataclass(frozen=True, slots=True, kw_only=True)
class CountCondition(Leaf):
    """How many targets are in sight.

    Attributes:
        targets: Of these; empty for all.
        at_least: Holds with no fewer than this; None for no such threshold.
        at_most: Holds with no more than this.
    """

    targets: tuple[str, ...] = ()
    at_least: int | None = None
    at_most: int | None = None

    noun = "count"
    is_by_cycle = True

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Those that it counts; empty for all."""
        return self.targets

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool:  # noqa: ARG002 - nothing is unsure of it
        """Return whether it holds; see `Leaf.holds`."""
        count = self.count(inputs)
        least, most = self.at_least, self.at_most
        return (least is None or count >= least) and (most is None or count <= most)

    def figures(self) -> tuple[Figure, ...]:
        """Return the count."""
        return (Figure(_in_sight, self.targets),)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:  # noqa: ARG002
        """Return that it stays as it is until the count changes."""
        count = self.count(inputs)
        return Rest(((self.figures()[0], count, count),))

    def count(self, inputs: RuleInputs) -> float:
        """Return how many of its targets are in sight."""
        return _in_sight(inputs, *self.targets)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure:  # noqa: ARG002
        """Return the count."""
        low, high = ends_of(self.at_least, self.at_most)
        return JudgedFigure(value=self.count(inputs), low=low, high=high)


def _in_sight(inputs: RuleInputs, *targets: str) -> float:
    """Return how many of some targets are in sight; of all, if none are named."""
    tracks = inputs.tracks
    return float(sum([tracks[target].is_valid for target in targets or tracks]))
