"""The actions of an alarm, and what it waits for, in words with figures."""

from __future__ import annotations

from stadimeter.core.alarms import machine
from stadimeter.core.alarms.machine import AlarmRecord
from stadimeter.core.condition_words import describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.rule import AlarmRule, LostPolicy
from stadimeter.core.words import duration


def latched_until(rule: AlarmRule, record: AlarmRecord) -> str:
    """Return until when an alarm that latched stays active, such as ``latched until it is reset``."""
    if rule.ack_resets:
        return "latched until it is acknowledged"
    return f"latched until it is {'' if record.is_acknowledged else 'acknowledged and '}reset"


def describe_alarm(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> str:
    """Return why an alarm does what it does, after a cycle, in words with figures."""
    if record.unknown_since_s is None:
        return in_words(rule, record, inputs)
    is_held = record.is_active and not record.has_let_go
    is_held = is_held and machine.decided_by_policy(rule, record, inputs.now_s) is None
    return f"{'held: ' if is_held else ''}{missing_in_words(rule, record, inputs)}: {in_words(rule, record, inputs)}"


def in_words(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs, *, with_probability: bool = False) -> str:
    """Return the figures behind the condition of an alarm."""
    return describe_verdict(
        rule.condition,
        inputs,
        record.timers.leaves,
        is_active=record.is_judged_by_its_end,
        with_probability=with_probability,
    )


def missing_in_words(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> str:
    """Say what is missing to judge by, for how long, and what it counts as. It need not be the rule's own target."""
    away_s = 0.0 if record.unknown_since_s is None else inputs.now_s - record.unknown_since_s
    seen = "not known" if inputs.tracks[rule.target].is_valid else "not seen"
    return f"{seen} for {away_s:.1f} s{policy_in_words(rule, record, inputs.now_s)}"


def given_up_in_words(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> str:
    """Say what becomes of an active alarm that has had nothing to judge by for too long."""
    is_latched = record.state in machine.LATCHED
    then = f"it stays {latched_until(rule, record)}" if is_latched else "the output goes to its safe value"
    return f"active, but {missing_in_words(rule, record, inputs)}; {then}"


def why_not_latched(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs) -> str:
    """Return why there is nothing to reset in an alarm."""
    if not record.is_active:
        return "it is not latched"
    if not rule.latch:
        return "it does not latch, and clears by itself"
    if record.unknown_since_s is None:
        return "its condition still holds"
    if rule.lost.policy is LostPolicy.HOLD:
        late = f"after {duration(rule.lost.fault_after_s)} (lost.fault_after)"
        return (
            f"its condition held when last known; {missing_in_words(rule, record, inputs)}, and it can be reset {late}"
        )
    return f"its condition counts as holding: {missing_in_words(rule, record, inputs)} (lost.policy)"


def policy_in_words(rule: AlarmRule, record: AlarmRecord, now_s: float) -> str:
    """Say what not seeing counts as, such as ``, which counts as danger``; empty while it counts as nothing."""
    decided = machine.decided_by_policy(rule, record, now_s)
    return "" if decided is None else ", which counts as danger" if decided else ", which counts as over"
