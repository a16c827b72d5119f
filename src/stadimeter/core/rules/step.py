"""What all kinds of rules have in common in a cycle."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.core.plan import Rule
from stadimeter.core.rules.request import Request


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What a rule does in one cycle. The same object is kept from cycle to cycle while nothing about it changes.

    Attributes:
        trace: What it is doing.
        request: What it wants of its output, None if nothing.
        rests: Whether nothing changes until the distance crosses one of the rule's limits, or the target comes or goes.
    """

    trace: RuleTrace
    request: Request | None = None
    rests: bool = False


def trace_of(rule: Rule, status: RuleStatus, before: RuleTrace | None = None) -> RuleTrace:
    """Return what a rule is doing.

    Args:
        rule: The rule.
        status: Its status.
        before: Its trace in the cycle before, which is returned if it says the same.

    Returns:
        The trace.
    """
    if before is not None and before.status is status:
        return before
    return RuleTrace(rule=rule.name, status=status, output=rule.output)
