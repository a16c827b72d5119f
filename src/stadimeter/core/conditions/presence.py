"""Whether a target is in sight, and for how long it has been."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.leaf import Figure, JudgedFigure, Leaf, Rest


@dataclass(frozen=True, slots=True, kw_only=True)
class PresenceCondition(Leaf):
    """Whether the target is in sight.

    Attributes:
        seen: True: holds while the target is tracked. False: holds while it is lost or was never seen.
        for_s: Only when that has been so for this long without a break.
        target: The target; empty for that of the rule.
    """

    seen: bool
    for_s: float = 0.0
    target: str = ""

    noun = "presence"
    is_by_cycle = True

    @property
    def unit(self) -> str:
        """Seconds, for one that takes time."""
        return "s" if self.for_s else ""

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Its target."""
        return (self.target,)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool:  # noqa: ARG002 - nothing is unsure of it
        """Return whether it holds; see `Leaf.holds`."""
        track = inputs.tracks[self.target]
        if track.is_valid is not self.seen:
            return False
        return not self.for_s or (track.since_s is not None and inputs.now_s >= track.since_s + self.for_s)

    def figures(self) -> tuple[Figure, ...]:
        """Return whether its target is in sight, 1 or 0."""
        return (Figure(_is_seen, (self.target,)),)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:  # noqa: ARG002
        """Return that it stays as it is until its target comes or goes, or until its time has come."""
        track = inputs.tracks[self.target]
        seen, due_s = float(track.is_valid), math.inf
        if self.for_s and track.is_valid is self.seen and track.since_s is not None:
            due_s = track.since_s + self.for_s
        return Rest(((self.figures()[0], seen, seen),), due_s if inputs.now_s < due_s else math.inf)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return for how many seconds it has been so, for one that takes time."""
        if not self.for_s:
            return None
        track = inputs.tracks[self.target]
        is_so = track.is_valid is self.seen and track.since_s is not None
        held_s = inputs.now_s - track.since_s if is_so and track.since_s is not None else 0.0
        return JudgedFigure(value=held_s, low=self.for_s)


def _is_seen(inputs: RuleInputs, target: str) -> float:
    return float(inputs.tracks[target].is_valid)
