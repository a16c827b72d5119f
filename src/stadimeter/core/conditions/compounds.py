"""The judging of conditions: simple ones, and those made of others with `all`, `any` and `not`.

Three-valued, after Kleene: what is not known is neither true nor false, and a whole is known as soon as no unknown part
could change it. `all` is false once one part is, `any` is true once one part is.

Each simple part has a memory of its own: whether it held in the sample before. While the alarm is active, a part that
held is judged by what ends it; a part that did not, by what begins it. While the alarm is inactive, all parts are
judged by what begins them. Below a `not` this is turned round: the whole begins only when the part has surely ended,
and ends only when the part has surely begun. So the figure that decides must come back over a deadband, wherever in the
condition it stands, and no figure that stands still makes an alarm come and go.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar, cast

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.conditions.leaf import Leaf, RuleInputs


class AllOf(Struct, frozen=True, kw_only=True):
    """Holds when each of its conditions, one or more, holds."""

    conditions: tuple[Condition, ...]


class AnyOf(Struct, frozen=True, kw_only=True):
    """Holds when at least one of its conditions holds."""

    conditions: tuple[Condition, ...]


class Not(Struct, frozen=True, kw_only=True):
    """Holds when its condition does not."""

    condition: Condition


Condition = Leaf | AllOf | AnyOf | Not

_C = TypeVar("_C", bound=Condition)


def leaves(condition: Condition) -> Iterator[Leaf]:
    """Yield the simple conditions that a condition is made of, from left to right."""
    return (leaf for leaf, _ in _list_leaves(condition, is_inverted=False))


def about(condition: _C, target: str, owner: str = "") -> _C:
    """Return a condition in which every part that names no target is about this one; the same object if all do.

    Args:
        owner: The rule whose condition it is: parts that sum up what others did note it.
    """
    before = [*leaves(condition)]
    after = [_leaf_about(leaf, target, owner) for leaf in before]
    is_same = all(new is old for new, old in zip(after, before, strict=True))
    return condition if is_same else cast(_C, with_leaves(condition, iter(after)))


def _leaf_about(leaf: Any, target: str, owner: str) -> Leaf:
    if leaf.rules_named and "owner" in leaf.__struct_fields__ and leaf.owner != owner:
        return cast(Leaf, replace(leaf, owner=owner))
    lacks_target = "target" in leaf.__struct_fields__ and not leaf.target
    return cast(Leaf, replace(leaf, target=target) if lacks_target else leaf)


def named_leaves(condition: Condition, within: str = "") -> Iterator[tuple[str, Leaf]]:
    """Yield the simple conditions with where each stands, such as ``all.0.not.``; empty for a condition without parts.

    Args:
        within: Where the condition itself stands.
    """
    match condition:
        case AllOf() | AnyOf():
            word = "all" if isinstance(condition, AllOf) else "any"
            for number, part in enumerate(condition.conditions):
                yield from named_leaves(part, f"{within}{word}.{number}.")
        case Not():
            yield from named_leaves(condition.condition, f"{within}not.")
        case _:
            yield within, condition


def with_leaves(condition: Condition, parts: Iterator[Condition]) -> Condition:
    """Return the same condition with others in place of its simple ones, from left to right, as many of them."""
    match condition:
        case AllOf() | AnyOf():
            return replace(condition, conditions=tuple([with_leaves(part, parts) for part in condition.conditions]))
        case Not():
            return Not(condition=with_leaves(condition.condition, parts))
        case _:
            return next(parts)


def depends_on(condition: Condition) -> frozenset[str]:
    """Return the names of the rules that a condition asks for."""
    return frozenset(rule for leaf in leaves(condition) for rule in leaf.rules_named)


def targets_of(condition: Condition) -> frozenset[str]:
    """Return the names of the targets that a condition is about, without those of a count of all targets."""
    return frozenset(target for leaf in leaves(condition) for target in leaf.targets_named)


class Verdict(Struct, frozen=True):
    """The answer to whether a condition holds.

    Attributes:
        value: None if it cannot be known. None is never taken for True or False.
        held: For each simple part, from left to right, whether it holds; for one that cannot be known, whether it did
            when it last could. Empty for a simple condition, whose memory is whether the alarm is active.
    """

    value: bool | None
    held: tuple[bool, ...] = ()


class JudgedLeaf(NamedTuple):
    """A simple part of a condition."""

    leaf: Leaf
    is_on: bool
    """Whether it is judged by what ends it, not by what begins it."""
    is_inverted: bool
    """Whether it stands below an odd number of `not`, so that the whole begins when it ends."""


def judge(condition: Condition, inputs: RuleInputs, held: tuple[bool, ...], *, is_active: bool) -> Verdict:
    """Judge a condition.

    Args:
        held: From the verdict on the sample before; empty for none.
        is_active: Whether the alarm is active: then the parts that held are judged by what ends them.
    """
    if isinstance(condition, Leaf):
        return Verdict(condition.holds(inputs, is_active))
    memory: list[bool] = []
    value = _judge_part(condition, inputs, held, memory, is_active, False)
    return Verdict(value, tuple(memory))


def judged_leaves(condition: Condition, held: tuple[bool, ...], *, is_active: bool) -> tuple[JudgedLeaf, ...]:
    """Return the simple parts of a condition, from left to right, and how `judge` judges each of them."""
    if isinstance(condition, Leaf):
        return (JudgedLeaf(condition, is_on=is_active, is_inverted=False),)
    parts = enumerate(_list_leaves(condition, is_inverted=False))
    return tuple(
        [
            JudgedLeaf(leaf, _is_on(held, index, is_active, is_inverted), is_inverted)
            for index, (leaf, is_inverted) in parts
        ]
    )


def judged_by_cycle(condition: Condition) -> bool:
    """Check whether any part of a condition may change though no frame comes, so that every cycle counts."""
    return any(leaf.is_by_cycle for leaf in leaves(condition))


def _judge_part(  # positional arguments: the hot path of a cycle
    condition: Condition,
    inputs: RuleInputs,
    held: tuple[bool, ...],
    memory: list[bool],
    is_active: bool,
    is_inverted: bool,
) -> bool | None:
    """Check whether a part of a condition holds. What to remember of its simple parts is added to the memory."""
    if isinstance(condition, Leaf):
        is_on = _is_on(held, len(memory), is_active, is_inverted)
        value = condition.holds(inputs, is_on)
        memory.append(is_on if value is None else value)
        return value
    if isinstance(condition, Not):
        value = _judge_part(condition.condition, inputs, held, memory, is_active, not is_inverted)
        return None if value is None else not value
    decisive = isinstance(condition, AnyOf)
    whole: bool | None = not decisive
    for part in condition.conditions:  # to the end, since each part has a memory to keep
        value = _judge_part(part, inputs, held, memory, is_active, is_inverted)
        if value is decisive:
            whole = decisive
        elif value is None and whole is not decisive:
            whole = None
    return whole


def _is_on(held: tuple[bool, ...], index: int, is_active: bool, is_inverted: bool) -> bool:
    """Check whether a simple part is judged by what ends it. While it cannot be judged it remembers the same.

    While the alarm is inactive, what was before does not count: so an alarm that rests need not be judged to remember.
    """
    if not is_active:
        return is_inverted
    return held[index] if index < len(held) else not is_inverted


def _list_leaves(condition: Condition, *, is_inverted: bool) -> Iterator[tuple[Leaf, bool]]:
    if isinstance(condition, Leaf):
        yield condition, is_inverted
    elif isinstance(condition, Not):
        yield from _list_leaves(condition.condition, is_inverted=not is_inverted)
    else:
        for part in condition.conditions:
            yield from _list_leaves(part, is_inverted=is_inverted)
