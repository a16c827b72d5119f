"""How many targets are in sight."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.intervals import Box, Truth, interval
from stadimeter.core.conditions.leaf import Band, Evidence, Figure, Leaf, Rest


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
        count = _in_sight(inputs, *self.targets)
        least, most = self.at_least, self.at_most
        return (least is None or count >= least) and (most is None or count <= most)

    def figures(self) -> tuple[Figure, ...]:
        """Return the count."""
        return (Figure(_in_sight, self.targets),)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:  # noqa: ARG002
        """Return that it stays as it is until the count changes."""
        count = _in_sight(inputs, *self.targets)
        return Rest(((self.figures()[0], count, count),))

    def in_words(self, inputs: RuleInputs, is_on: bool, *, names_target: bool) -> str:  # noqa: ARG002
        """Return the count; see `Leaf.in_words`."""
        thresholds = [f"at least {self.at_least}"] if self.at_least is not None else []
        thresholds += [f"at most {self.at_most}"] if self.at_most is not None else []
        number = len(self.targets or inputs.tracks)
        return f"{_in_sight(inputs, *self.targets):.0f} of {number} in sight, {' and '.join(thresholds)}"

    def evidence(self, inputs: RuleInputs, is_on: bool) -> Evidence:
        """Return the count and its thresholds."""
        least, most = (None if number is None else float(number) for number in (self.at_least, self.at_most))
        found = Leaf.evidence(self, inputs, is_on)
        return replace(found, value=_in_sight(inputs, *self.targets), low=least, high=most)

    def begins(self) -> str:
        """Return a clause that says when it begins."""
        least, most = self.at_least, self.at_most
        if least is None or most is None:
            number = f"at most {most}" if least is None else f"at least {least}"
        else:
            number = f"{least}" if least == most else f"{least} to {most}"
        if not self.targets:
            return f"{number} targets are in sight"
        return f"{number} of {', '.join(f'`{target}`' for target in self.targets)} are in sight"

    def band(self) -> Band | None:
        """Return its thresholds for `check`, each half a target outwards: a count is a whole number."""
        if self.at_least is None or self.at_most is None:
            return None
        return Band(self.noun, self.at_least - 0.5, self.at_most + 0.5, "")

    def situations(self, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:
        """Yield the boxes of situations in which it is so; see `Leaf.situations`."""
        if truth is Truth.UNKNOWN:
            return
        counted = tuple(sorted(set(self.targets or targets)))
        at_least = -math.inf if self.at_least is None else self.at_least - 0.5
        at_most = math.inf if self.at_most is None else self.at_most + 0.5
        holds = interval(at_least, at_most)
        # Whole numbers from none to all, each with the half before and after it.
        possible = interval(-0.5, len(counted) + 0.5)
        yield {("count", *counted): possible & (holds if truth is Truth.TRUE else ~holds)}


def _in_sight(inputs: RuleInputs, *targets: str) -> float:
    """Return how many of some targets are in sight; of all, if none are named."""
    tracks = inputs.tracks
    return float(sum([tracks[target].is_valid for target in targets or tracks]))
