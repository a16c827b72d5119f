"""The condition that rules were raised in a certain order, soon after each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

from msgspec import Struct

from stadimeter.core.conditions.leaf import Leaf, RuleInputs
from stadimeter.core.words import duration

# What is in time is in time, however a difference of times was rounded.
_ROUNDING_S = 1e-6


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
        """Return when each rule was raised last; see `Leaf.verdict`."""
        ago = [
            f"{rule} was raised {inputs.now_s - at_s:.1f} s ago" if at_s is not None else f"{rule} was not raised"
            for rule, at_s in ((rule, inputs.raised_at_s.get(rule)) for rule in self.rules)
        ]
        return f"{', '.join(ago)}; in this order within {duration(self.within_s)}"
