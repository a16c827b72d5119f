"""Whether another rule is active. Unknown while that rule has nothing to judge by."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.intervals import NO, NOT_KNOWN, YES, Box, Truth
from stadimeter.core.conditions.leaf import Leaf, Rest


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleCondition(Leaf):
    """Whether another rule is active. Unknown while that rule has nothing to judge by."""

    rule: str

    noun = "rule"
    is_by_cycle = True
    is_sure = True

    @property
    def about(self) -> tuple[str, ...]:
        """The other rule."""
        return (self.rule,)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Return whether it holds; see `Leaf.holds`."""
        return inputs.active.get(self.rule)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:  # noqa: ARG002
        """Return that it stays as it is: whoever judges the other rule judges those that ask for it after it."""
        return Rest()

    def in_words(self, inputs: RuleInputs, is_on: bool, *, names_target: bool) -> str:  # noqa: ARG002
        """Return what the other rule is doing; see `Leaf.in_words`."""
        state = {True: "is active", False: "is not active", None: "has nothing to judge by"}
        return f"the rule {self.rule} {state[inputs.active.get(self.rule)]}"

    def begins(self) -> str:
        """Return a clause that says when it begins."""
        return f"`{self.rule}` is active"

    def situations(self, truth: Truth, targets: tuple[str, ...]) -> Iterator[Box]:  # noqa: ARG002
        """Yield the boxes of situations in which it is so; see `Leaf.situations`."""
        yield {("rule", self.rule): {Truth.TRUE: YES, Truth.FALSE: NO, Truth.UNKNOWN: NOT_KNOWN}[truth]}
