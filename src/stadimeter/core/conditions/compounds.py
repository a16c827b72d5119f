"""Conditions made of others with `all`, `any` and `not`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar, cast

from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.other_rule import RuleCondition


@dataclass(frozen=True, slots=True, kw_only=True)
class AllOf:
    """Holds when each of its conditions, one or more, holds."""

    conditions: tuple[Condition, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnyOf:
    """Holds when at least one of its conditions holds."""

    conditions: tuple[Condition, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Not:
    """Holds when its condition does not."""

    condition: Condition


Condition = Leaf | AllOf | AnyOf | Not

_C = TypeVar("_C", bound=Condition)


def leaves(condition: Condition) -> Iterator[Leaf]:
    """Yield the simple conditions that a condition is made of, from left to right."""
    match condition:
        case AllOf() | AnyOf():
            for part in condition.conditions:
                yield from leaves(part)
        case Not():
            yield from leaves(condition.condition)
        case _:
            yield condition


def about(condition: _C, target: str) -> _C:
    """Return a condition in which every part that names no target is about this one; the same object if all do."""
    match condition:
        case AllOf() | AnyOf():
            parts = tuple(about(part, target) for part in condition.conditions)
            is_same = all(part is old for part, old in zip(parts, condition.conditions, strict=True))
            return condition if is_same else replace(condition, conditions=parts)
        case Not():
            part = about(condition.condition, target)
            return condition if part is condition.condition else replace(condition, condition=part)
        case _:
            leaf: Any = condition
            lacks_target = any(field.name == "target" for field in fields(leaf)) and not leaf.target
            return cast(_C, replace(leaf, target=target)) if lacks_target else condition


def depends_on(condition: Condition) -> frozenset[str]:
    """Return the names of the rules that a condition asks for."""
    return frozenset(leaf.rule for leaf in leaves(condition) if isinstance(leaf, RuleCondition))


def targets_of(condition: Condition) -> frozenset[str]:
    """Return the names of the targets that a condition is about, without those of a count of all targets."""
    return frozenset(target for leaf in leaves(condition) for target in leaf.targets_named)
