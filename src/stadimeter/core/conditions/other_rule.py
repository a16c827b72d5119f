"""Whether another rule is active. Unknown while that rule has nothing to judge by."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.leaf import Leaf, Rest


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleCondition(Leaf):
    """Whether another rule is active. Unknown while that rule has nothing to judge by."""

    rule: str

    noun = "rule"
    is_by_cycle = True

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002
        """Return whether it holds; see `Leaf.holds`."""
        return inputs.active.get(self.rule)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:  # noqa: ARG002
        """Return that it stays as it is: the scheduler evaluates it when the other rule changes."""
        return Rest()
