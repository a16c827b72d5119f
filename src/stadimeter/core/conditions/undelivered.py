"""A condition that holds while an alarm has not reached those who are to hear of it."""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, RuleInputs
from stadimeter.core.words import duration


class UndeliveredCondition(Leaf, Struct, frozen=True, kw_only=True):
    """An alarm's message or notification has waited for this long, and neither broker nor service has taken it.

    It is never unknown: a run without a messenger has nothing to deliver.
    """

    for_s: float

    noun = "undelivered alarm"
    unit = "s"
    is_by_cycle = is_always_known = True
    has_noise = False

    @property
    def limits(self) -> tuple[float, float]:
        """In seconds."""
        return self.for_s, math.inf

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool:  # noqa: ARG002 - nothing is unsure of it
        """Check whether it holds; see `Leaf.holds`."""
        since_s = inputs.undelivered_since_s
        return since_s is not None and inputs.now_s >= since_s + self.for_s

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return for how many seconds the oldest alarm waits; None for none."""
        since_s = inputs.undelivered_since_s
        return None if since_s is None else JudgedFigure(value=inputs.now_s - since_s, low=self.for_s)

    @property
    def begins(self) -> str:
        """The time."""
        return f"an alarm is undelivered for {duration(self.for_s)}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return for how long the oldest alarm waits; see `Leaf.verdict`."""
        reading = self.reading(inputs, is_on)
        if reading is None:
            return "no alarm is undelivered"
        return f"an alarm is undelivered for {reading.value:.1f} s of {self.for_s:g} s"
