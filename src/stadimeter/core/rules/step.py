"""What all kinds of rules have in common in a cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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


def trace_of(rule: Rule, status: RuleStatus, before: RuleTrace | None = None) -> RuleTrace:
    """Return the trace of a rule without a memory: it is active while it acts."""
    active = None if status is RuleStatus.UNKNOWN else status is RuleStatus.ACTIVE
    gates = (OBSERVED,) if rule.observe else ()
    now = RuleTrace(rule=rule.name, status=status, output=rule.output, gates=gates, active=active)
    return now if before is None else renewed(now, before)


def renewed(now: RuleTrace, before: RuleTrace) -> RuleTrace:
    """Return a trace; that of the cycle before if it says the same. Which alarm came first is marked elsewhere."""
    if now.first_out is not before.first_out:
        now = replace(now, first_out=before.first_out)
    return before if now == before else now
