"""Conditions that ask for the opposite of another rule, and are unknown while that rule cannot be judged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from stadimeter.config.analysis.logic import Goal, Logic, Wanted
from stadimeter.config.analysis.subject import Subject
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import WrittenCondition
from stadimeter.core.condition import AllOf, AnyOf, Condition, Not, PresenceCondition, RuleCondition, leaves, targets_of
from stadimeter.core.rule import AlarmRule, AnyRule, LostPolicy

_NEVER = AnyOf(conditions=())
"""A condition that never holds."""


def unknown_warnings(subject: Subject) -> Iterator[Finding]:
    """Find conditions that would hold if another rule counted as not active where nothing is known of it."""
    rules = {each.rule.name: each.rule for each in subject.every_rule}
    for declared, alarm in subject.alarms:
        for written in declared.conditions():
            is_own = written.condition is alarm.condition
            if is_own and alarm.lost.policy is LostPolicy.ASSERT:
                continue  # what is unknown counts as holding
            effect = f"'{alarm.name}' is not raised" if is_own else f"'{alarm.name}' is not suppressed"
            for leaf in written.leaves():
                asked = rules.get(leaf.condition.rule) if isinstance(leaf.condition, RuleCondition) else None
                if asked is not None and _is_missed(subject.logic, written.condition, asked):
                    yield _finding(leaf, asked, effect)
                    break


def _is_missed(logic: Logic, condition: Condition, asked: AnyRule) -> bool:
    """Return whether it may be only a rule whose targets are out of sight that keeps a condition from holding."""
    own = RuleCondition(rule=asked.name)
    unknown: list[Goal] = [(own, Wanted.NOT_TRUE), (own, Wanted.NOT_FALSE)]
    targets = targets_of(asked.condition) if isinstance(asked, AlarmRule) else {asked.target}
    unseen: list[Goal] = [(PresenceCondition(seen=True, target=target), Wanted.FALSE) for target in sorted(targets)]
    missed: list[Goal] = [(_without(condition, asked.name), Wanted.TRUE), (condition, Wanted.NOT_TRUE)]
    return _may_be_unknown(logic, asked, unseen) and logic.can_be(*unseen, *unknown, *missed)


def _may_be_unknown(logic: Logic, asked: AnyRule, unseen: list[Goal]) -> bool:
    """Return whether it may be unknown whether a rule is active while its targets are out of sight."""
    if not isinstance(asked, AlarmRule):
        return True
    if asked.lost.policy is not LostPolicy.HOLD or not any(leaf.has_figures for leaf in leaves(asked.condition)):
        return False
    return logic.can_be(*unseen, (asked.condition, Wanted.NOT_TRUE), (asked.condition, Wanted.NOT_FALSE))


def _without(condition: Condition, rule: str) -> Condition:
    """Return a condition for which a rule is never active."""
    match condition:
        case AllOf() | AnyOf():
            return replace(condition, conditions=tuple(_without(part, rule) for part in condition.conditions))
        case Not():
            return Not(condition=_without(condition.condition, rule))
        case RuleCondition() if condition.rule == rule:
            return _NEVER
        case _:
            return condition


def _finding(leaf: WrittenCondition, asked: AnyRule, effect: str) -> Finding:
    message = (
        f"while '{asked.target}' is out of sight, from the start on, nothing is known of '{asked.name}' unless it is "
        f"active: this is unknown then, and {effect}"
    )
    if isinstance(asked, AlarmRule):
        section = asked.name.partition(":")[0]
        hint = f'write lost = {{ policy = "clear" }} in [rules.{section}]: then it counts as not active'
    else:
        hint = "ask for the target in place of the rule, such as any = [{ lost = true }, { below = … }]"
    return Finding((*leaf.path, "rule"), message, hint, "unknown-rule")
