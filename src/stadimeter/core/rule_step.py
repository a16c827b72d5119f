"""The step of one rule in a cycle: what it does, and wants of outputs."""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.core.rule import Rule

# The inhibit of a rule that is only observed.
OBSERVED = "observed"


class LevelRequest(Struct, frozen=True, kw_only=True, tag=True):
    """A rule wants an actuator to act, at a level from 0 to 1. Of several requests the highest priority wins.

    With `by`, a person who holds the output wants it, and no rule; likewise below.
    """

    rule: str
    output: str
    priority: int
    level: float
    by: str = ""


class TwistRequest(Struct, frozen=True, kw_only=True, tag=True):
    """A rule wants a base to move, or to stand still; signs as of `TwistCommand`.

    With `is_gentle`, it slows down no faster than it speeds up; else it stands as soon as it shall.
    """

    rule: str
    output: str
    priority: int
    linear_mps: float
    angular_radps: float
    tilt_radps: float = 0.0
    by: str = ""
    is_gentle: bool = False


Request = LevelRequest | TwistRequest


class Step(Struct, frozen=True, kw_only=True):
    """The step of a rule in one cycle. The same object is kept from cycle to cycle while nothing about it changes."""

    trace: RuleTrace
    requests: tuple[Request, ...] = ()


def trace_of(
    rule: Rule, status: RuleStatus, before: RuleTrace | None = None, inhibits: tuple[str, ...] | None = None
) -> RuleTrace:
    """Return the trace of a rule that is active while it acts.

    Args:
        inhibits: What keeps it quiet, in words; None for no more than its own `observe`.
    """
    active = None if status is RuleStatus.UNKNOWN else status is RuleStatus.ACTIVE
    if inhibits is None:
        inhibits = (OBSERVED,) if rule.observe else ()
    now = RuleTrace(rule=rule.name, status=status, output=rule.output, inhibits=inhibits, active=active)
    return now if before is None else keep_if_same(now, before)


def keep_if_same(now: RuleTrace, before: RuleTrace) -> RuleTrace:
    """Return a trace; that of the cycle before if it says the same. Which alarm came first is marked elsewhere."""
    if now.first_out is not before.first_out:
        now = replace(now, first_out=before.first_out)
    return before if now == before else now
