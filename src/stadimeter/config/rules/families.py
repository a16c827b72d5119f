"""Rules that stand for several: one table that names several targets becomes one alarm for each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from stadimeter.core.condition import AllOf, AnyOf, Condition, Not, RuleCondition
from stadimeter.core.rule import AlarmRule, AnyRule


def naming_members(rules: Iterable[AnyRule], families: Mapping[str, tuple[str, ...]]) -> tuple[AnyRule, ...]:
    """Let conditions that ask for a whole family of rules ask for its members.

    Args:
        rules: The rules.
        families: For the name of each table the names of the rules that it stands for.

    Returns:
        The rules; that a family is active means that at least one of its members is.
    """
    several = {name: members for name, members in families.items() if members != (name,)}
    return tuple(rules) if not several else tuple(_in_rule(rule, several) for rule in rules)


def _in_rule(rule: AnyRule, families: Mapping[str, tuple[str, ...]]) -> AnyRule:
    if not isinstance(rule, AlarmRule):
        return rule
    unless = rule.suppress_when
    return replace(
        rule,
        condition=_in_condition(rule.condition, families),
        suppress_when=None if unless is None else _in_condition(unless, families),
    )


def _in_condition(condition: Condition, families: Mapping[str, tuple[str, ...]]) -> Condition:
    match condition:
        case AllOf() | AnyOf():
            return replace(condition, conditions=tuple(_in_condition(part, families) for part in condition.conditions))
        case Not():
            return Not(condition=_in_condition(condition.condition, families))
        case RuleCondition() if condition.rule in families:
            return AnyOf(conditions=tuple(RuleCondition(rule=name) for name in families[condition.rule]))
        case _:
            return condition
