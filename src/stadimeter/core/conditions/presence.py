"""Whether a target is in sight, and for how long it has been."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.intervals import Box, Truth, interval
from stadimeter.core.conditions.leaf import Evidence, Figure, Leaf, Rest
from stadimeter.core.words import duration


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

    def in_words(self, inputs: RuleInputs, is_on: bool, *, names_target: bool) -> str:  # noqa: ARG002
        """Return its target's status; see `Leaf.in_words`."""
        track = inputs.tracks[self.target]
        words = f"{track.target} is {track.status.value}"
        if self.for_s and track.is_valid is self.seen and track.since_s is not None:
            words += f" for {inputs.now_s - track.since_s:.1f} s of {self.for_s:g} s"
        return words + (f": {track.reason}" if track.reason else "")

    def evidence(self, inputs: RuleInputs, is_on: bool) -> Evidence:
        """Return its status and, for one that takes time, how long it has been so."""
        found = Leaf.evidence(self, inputs, is_on)
        if not self.for_s:
            return found
        track = inputs.tracks[self.target]
        is_so = track.is_valid is self.seen and track.since_s is not None
        held_s = inputs.now_s - track.since_s if is_so and track.since_s is not None else 0.0
        return replace(found, unit="s", value=held_s, low=self.for_s)

    def begins(self) -> str:
        """Return a clause that says when it begins."""
        since = f" for {duration(self.for_s)}" if self.for_s else ""
        return f"`{self.target}` is {'in' if self.seen else 'out of'} sight{since}"

    def situations(self, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:  # noqa: ARG002
        """Yield the boxes of situations in which it is so; see `Leaf.situations`."""
        if truth is not Truth.UNKNOWN:
            holds = interval(self.for_s, None) if self.seen else interval(None, -self.for_s)
            yield {("in sight", self.target): holds if truth is Truth.TRUE else ~holds}


def _is_seen(inputs: RuleInputs, target: str) -> float:
    return float(inputs.tracks[target].is_valid)
