"""The gate of a rule that acts in proportion: whether it may act, and what keeps it quiet.

A gate is judged as an alarm is, with hysteresis, and operators shelve it, take it out of service and put it back as
one. It has no delays: it is open while its condition holds, and closed while it does not. Where that is not known the
rule does not act either, whatever was before: nothing moves by guess.
"""

from __future__ import annotations

from typing import NamedTuple

from stadimeter.core.alarms.actions import Evaluation, stand
from stadimeter.core.alarms.alarm import OperatedStep
from stadimeter.core.alarms.machine import AlarmRecord
from stadimeter.core.alarms.state import NO_INHIBITS
from stadimeter.core.condition_words import describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decision import Event
from stadimeter.core.rule import ALWAYS, AlarmRule
from stadimeter.core.rule_step import OBSERVED


class GatedStep(OperatedStep, frozen=True, kw_only=True):
    """The step of a rule with a gate in one cycle, and what it remembers.

    Attributes:
        is_open: Whether the condition of its gate held; None if that was not known.
        held: Whether each part of that condition did.
    """

    is_open: bool | None = None
    held: tuple[bool, ...] = ()


class Gate(NamedTuple):
    """A gate after a cycle."""

    record: AlarmRecord | None
    """None if it is that of the cycle before."""
    is_open: bool | None
    held: tuple[bool, ...]
    inhibits: tuple[str, ...]
    """What keeps the rule quiet, in words."""
    events: tuple[Event, ...]

    @property
    def lets_move(self) -> bool | None:
        """True if a base may be driven; None if that is not known. One that is only observed goes on being judged."""
        return False if any(word != OBSERVED for word in self.inhibits) else self.is_open


# The gate of a rule that has none.
OPEN = Gate(None, True, (), (), ())
_OPEN_OBSERVED = OPEN._replace(inhibits=(OBSERVED,))


def step_gate(rule: AlarmRule, before: GatedStep, inputs: RuleInputs) -> Gate:
    """Judge a gate for one cycle.

    Args:
        before: The step of its rule in the cycle before.
    """
    record = before.record
    if rule.condition is ALWAYS and rule.suppress_when is None and record.inhibits is NO_INHIBITS:
        return _OPEN_OBSERVED if rule.observe else OPEN
    evaluation = Evaluation(rule, record, inputs)
    verdict = evaluation.judge(rule.condition, before.held, is_active=before.is_open is True)
    stand(evaluation)
    is_same = evaluation.record == record
    words = evaluation.record.inhibits.words()
    inhibits = (*words, OBSERVED) if rule.observe else words
    after = None if is_same else evaluation.record
    return Gate(after, verdict.value, verdict.held, inhibits, evaluation.events)


def describe_gate(rule: AlarmRule, step: GatedStep, inputs: RuleInputs) -> str:
    """Return why a gate does not let its rule act, in words with figures; empty where it does."""
    if step.is_open:
        return ""
    words = describe_verdict(rule.condition, inputs, step.held, is_active=False)
    return f"its `when` {'cannot be known' if step.is_open is None else 'does not hold'}: {words}"
