"""What one rule does in a cycle, and wants of outputs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.core.rule import Rule

OBSERVED = "observed"
"""The gate of a rule that is only observed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelRequest:
    """A rule wants an actuator to act, at a level from 0 to 1. Of several requests the highest priority wins."""

    rule: str
    output: str
    priority: int
    level: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TwistRequest:
    """A rule wants a base to move, or to stand still. A rate of turn is positive to the left."""

    rule: str
    output: str
    priority: int
    linear_mps: float
    angular_radps: float


Request = LevelRequest | TwistRequest


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What a rule does in one cycle. The same object is kept from cycle to cycle while nothing about it changes.

    Attributes:
        rests: Whether nothing changes while the verdicts of its conditions stay as they are, and until it is `due_s`.
        due_s: When one of its timers fires, on the run's clock; infinite for never.
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
    """Return what a rule is doing; the trace of the cycle before if it says the same.

    Args:
        rule: The rule.
        status: What it is doing.
        before: Its trace in the cycle before.
        acknowledged: Whether nobody needs to acknowledge it, or somebody has.
        gates: What keeps it from acting, beside being observed only.
    """
    if rule.observe:
        gates = (*gates, OBSERVED)
    if before is not None and before.status is status and before.acknowledged is acknowledged and before.gates == gates:
        return before
    return RuleTrace(
        rule=rule.name,
        status=status,
        output=rule.output,
        acknowledged=acknowledged,
        gates=gates,
        first_out=before is not None and before.first_out,
    )
