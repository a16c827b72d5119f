"""Conditions on other rules: that one is active, that several were raised in an order, that an alarm is undelivered."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

from msgspec import Struct

from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, RuleInputs
from stadimeter.core.words import duration

# What is in time is in time, however a difference of times was rounded.
_ROUNDING_S = 1e-6

_RULE_STATES = {True: "is active", False: "is not active", None: "has nothing to judge by"}


class RuleCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition that another rule is active. Unknown while that rule has nothing to judge by."""

    rule: str

    noun = "rule"
    is_by_cycle = True
    has_noise = False

    @property
    def rules_named(self) -> tuple[str, ...]:
        """That rule."""
        return (self.rule,)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Check whether it holds; see `Leaf.holds`."""
        return inputs.active.get(self.rule)

    @property
    def begins(self) -> str:
        """The rule."""
        return f"`{self.rule}` is active"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the state of the rule; see `Leaf.verdict`."""
        return f"the rule {self.rule} {_RULE_STATES[inputs.active.get(self.rule)]}"


class SequenceCondition(Leaf, Struct, frozen=True, kw_only=True):
    """Rules were raised in this order, each after the one before, from the first to the last within a time.

    What counts of each is when it was raised last. It is noted once, when the last is raised: what the others do later
    changes nothing.

    Attributes:
        rules: Two or more.
        for_s: It holds for this long since the last was raised; None for as long as that rule is active.
    """

    rules: tuple[str, ...]
    within_s: float
    for_s: float | None = None

    noun = "order of rules"
    is_by_cycle = is_always_known = True
    has_noise = False

    @property
    def rules_named(self) -> tuple[str, ...]:
        """The rules, in their order."""
        return self.rules

    @property
    def key(self) -> str:
        """The key that its completion is remembered by."""
        return f"{' then '.join(self.rules)} within {self.within_s!r} s"

    def is_complete(self, raised_at_s: Mapping[str, float]) -> bool:
        """Check whether the rules were raised in their order, in time."""
        times = [raised_at_s.get(rule, math.nan) for rule in self.rules]
        in_order = all(before < after for before, after in pairwise(times))
        return in_order and times[-1] - times[0] <= self.within_s + _ROUNDING_S

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002 - nothing is unsure of it
        """Check whether it holds; None while its last rule, a ramp or one that follows, has nothing to judge by."""
        at_s, last = inputs.raised_at_s.get(self.key), self.rules[-1]
        if at_s is None:
            return False
        if self.for_s is not None:
            return inputs.now_s < at_s + self.for_s
        return at_s == inputs.raised_at_s.get(last) and inputs.active.get(last)

    @property
    def begins(self) -> str:
        """The rules, in their order, and the time."""
        names = " and then ".join(f"`{rule}`" for rule in self.rules)
        lasts = "" if self.for_s is None else f", for {duration(self.for_s)} from then on"
        return f"{names} are raised within {duration(self.within_s)}{lasts}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:  # noqa: ARG002
        """Return the times at which the rules were raised last; see `Leaf.verdict`."""
        ago = [
            f"{rule} was raised {inputs.now_s - at_s:.1f} s ago" if at_s is not None else f"{rule} was not raised"
            for rule, at_s in ((rule, inputs.raised_at_s.get(rule)) for rule in self.rules)
        ]
        return f"{', '.join(ago)}; in this order within {duration(self.within_s)}"


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
