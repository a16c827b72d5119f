"""Whether a condition holds: simple ones, and those made of others with `all`, `any` and `not`.

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
from dataclasses import dataclass
from typing import NamedTuple

from stadimeter.core.conditions.compounds import AnyOf, Condition, Not, leaves
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.leaf import Leaf, Rest


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a condition holds.

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


_SIMPLE = {value: Verdict(value) for value in (True, False, None)}


def judge(condition: Condition, inputs: RuleInputs, held: tuple[bool, ...], *, is_active: bool) -> Verdict:
    """Judge a condition.

    Args:
        held: From the verdict on the sample before; empty for none.
        is_active: Whether the alarm is active: then the parts that held are judged by what ends them.
    """
    if isinstance(condition, Leaf):
        return _SIMPLE[condition.holds(inputs, is_active)]
    memory: list[bool] = []
    value = _judge_part(condition, inputs, held, memory, is_active, False)
    return Verdict(value, tuple(memory))


def rest_of(condition: Condition, inputs: RuleInputs, held: tuple[bool, ...], *, is_active: bool) -> Rest | None:
    """Return for how long what `judge` returns for the same arguments surely stays; None for not at all."""
    if isinstance(condition, Leaf):
        return condition.rest(inputs, is_active)
    return _rest(condition, inputs, held, [], is_active, False)[1]


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
    """Return whether any part of a condition may change though no frame comes, so that every cycle counts."""
    return any(leaf.is_by_cycle for leaf in leaves(condition))


def _judge_part(  # positional arguments: the hot path of a cycle
    condition: Condition,
    inputs: RuleInputs,
    held: tuple[bool, ...],
    memory: list[bool],
    is_active: bool,
    is_inverted: bool,
) -> bool | None:
    """Return whether a part of a condition holds, and add to the memory what to remember of its simple parts."""
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
    """Return whether a simple part is judged by what ends it. While it cannot be judged it remembers the same.

    While the alarm is inactive, what was before does not count: so an alarm that rests need not be judged to remember.
    """
    if not is_active:
        return is_inverted
    return held[index] if index < len(held) else not is_inverted


def _rest(
    condition: Condition,
    inputs: RuleInputs,
    held: tuple[bool, ...],
    gone: list[None],
    is_active: bool,
    is_inverted: bool,
) -> tuple[bool | None, Rest | None]:
    """Return whether a part of a condition holds, and for how long; `gone` has one entry for each part visited."""
    if isinstance(condition, Leaf):
        is_on = _is_on(held, len(gone), is_active, is_inverted)
        gone.append(None)
        return condition.holds(inputs, is_on), condition.rest(inputs, is_on)
    if isinstance(condition, Not):
        value, rest = _rest(condition.condition, inputs, held, gone, is_active, not is_inverted)
        return None if value is None else not value, rest
    decisive = isinstance(condition, AnyOf)
    whole: bool | None = not decisive
    together: Rest | None = Rest()
    decided: Rest | None = None
    for part in condition.conditions:
        value, rest = _rest(part, inputs, held, gone, is_active, is_inverted)
        if value is decisive:
            whole = decisive
            decided = decided or rest
        elif value is None and whole is not decisive:
            whole = None
        together = None if together is None or rest is None else together & rest
    # One part is enough to decide; but while the alarm is active each part has a memory that may change.
    return whole, together if is_active or decided is None else decided


def _list_leaves(condition: Condition, *, is_inverted: bool) -> Iterator[tuple[Leaf, bool]]:
    if isinstance(condition, Leaf):
        yield condition, is_inverted
    elif isinstance(condition, Not):
        yield from _list_leaves(condition.condition, is_inverted=not is_inverted)
    else:
        for part in condition.conditions:
            yield from _list_leaves(part, is_inverted=is_inverted)
