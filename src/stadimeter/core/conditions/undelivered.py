"""Whether an alarm has not reached those who are to hear of it."""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.conditions.leaf import UNKNOWN, Figure, JudgedFigure, Leaf, Rest, RuleInputs


class UndeliveredCondition(Leaf, Struct, frozen=True, kw_only=True):
    """An alarm's message or notification has waited for this long, and neither broker nor service has taken it.

    It is never unknown: a run without a messenger has nothing to deliver.
    """

    for_s: float

    noun = "undelivered alarm"
    unit = "s"
    is_by_cycle = is_always_known = True

    @property
    def limits(self) -> tuple[float, float]:
        """In seconds."""
        return self.for_s, math.inf

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool:  # noqa: ARG002 - nothing is unsure of it
        """Return whether it holds; see `Leaf.holds`."""
        since_s = inputs.undelivered_since_s
        return since_s is not None and inputs.now_s >= since_s + self.for_s

    def figures(self) -> tuple[Figure, ...]:
        """Return since when the oldest alarm waits."""
        return (Figure(_since_s, ()),)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:
        """Return that it stays as it is until another alarm is the oldest, or until its time has come."""
        since_s = _since_s(inputs)
        due_s = math.inf if since_s == UNKNOWN or self.holds(inputs, is_on) else since_s + self.for_s
        return Rest(((self.figures()[0], since_s, since_s),), due_s)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return for how many seconds the oldest alarm waits; None for none."""
        since_s = inputs.undelivered_since_s
        return None if since_s is None else JudgedFigure(value=inputs.now_s - since_s, low=self.for_s)


def _since_s(inputs: RuleInputs) -> float:
    return UNKNOWN if inputs.undelivered_since_s is None else inputs.undelivered_since_s
