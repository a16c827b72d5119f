"""What all kinds of rules have in common in a cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.core.rule import Rule
from stadimeter.core.rules.request import Request

OBSERVED = "observed"
"""The gate of a rule that is only observed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What a rule does in one cycle. The same object is kept from cycle to cycle while nothing about it changes.

    Attributes:
        trace: What it is doing.
        requests: What it wants of outputs.
        rests: Whether nothing changes until the distance crosses one of the rule's limits, the target comes or goes,
            or it is `due_s`.
        due_s: When a rule that rests must be judged again all the same, on the run's clock; infinite for never.
    """

    trace: RuleTrace
    requests: tuple[Request, ...] = ()
    rests: bool = False
    due_s: float = math.inf


def trace_of(
    rule: Rule,
    status: RuleStatus,
    before: RuleTrace | None = None,
    *,
    acknowledged: bool = True,
    gates: tuple[str, ...] = (),
) -> RuleTrace:
    """Return what a rule is doing.

    Args:
        rule: The rule.
        status: Its status.
        before: Its trace in the cycle before, which is returned if it says the same.
        acknowledged: Whether nobody needs to acknowledge it, or somebody has.
        gates: What keeps it from acting, beside being observed only.

    Returns:
        The trace.
    """
    if rule.observe:
        gates = (*gates, OBSERVED)
    if before is not None and before.status is status and before.acknowledged is acknowledged and before.gates == gates:
        return before
    first_out = before is not None and before.first_out
    return RuleTrace(
        rule=rule.name,
        status=status,
        output=rule.output,
        acknowledged=acknowledged,
        gates=gates,
        first_out=first_out,
    )
