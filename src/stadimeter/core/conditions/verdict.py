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

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from stadimeter.core.condition import (
    AllOf,
    AnyOf,
    Condition,
    CountCondition,
    DistanceCondition,
    Leaf,
    Not,
    PresenceCondition,
    RuleCondition,
    ScheduleCondition,
    leaves,
)
from stadimeter.core.conditions.figures import no_figures, quantity_of
from stadimeter.core.conditions.known import Known
from stadimeter.core.conditions.leaf import leaf_due_s, leaf_holds, leaf_rests
from stadimeter.core.conditions.words import leaf_in_words

__all__ = [
    "Part",
    "Verdict",
    "due_s",
    "in_words",
    "judge",
    "judged_by_cycle",
    "no_figures",
    "parts_of",
    "quantity_of",
    "rests",
]


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a condition holds.

    Attributes:
        value: True or False; None if it cannot be known. None is never taken for either.
        held: For each simple part, from left to right, whether it holds; for one that cannot be known, whether it did
            when it last could. Empty for a simple condition, whose memory is whether the alarm is active.
    """

    value: bool | None
    held: tuple[bool, ...] = ()


class Part(NamedTuple):
    """A simple part of a condition.

    Attributes:
        leaf: The part.
        is_on: Whether it is judged by what ends it, not by what begins it.
        is_inverted: Whether it stands below an odd number of `not`, so that the whole begins when it ends.
    """

    leaf: Leaf
    is_on: bool
    is_inverted: bool


_SIMPLE = {value: Verdict(value) for value in (True, False, None)}
_GROUPS = (AllOf, AnyOf)
_COMPOUNDS = (AllOf, AnyOf, Not)


def judge(condition: Condition, known: Known, held: tuple[bool, ...], *, is_active: bool) -> Verdict:
    """Judge a condition.

    Args:
        condition: The condition.
        known: What is known in this cycle.
        held: From the verdict on the sample before; empty for none.
        is_active: Whether the alarm is active: then the parts that held are judged by what ends them.

    Returns:
        Whether it holds, and what to remember of its parts.
    """
    if type(condition) is DistanceCondition or not isinstance(condition, _COMPOUNDS):
        return _SIMPLE[leaf_holds(condition, known, is_active)]
    memory: list[bool] = []
    value = _judged(condition, known, held, memory, is_active, False)
    return Verdict(value, tuple(memory))


def in_words(condition: Condition, known: Known, held: tuple[bool, ...], *, is_active: bool) -> str:
    """Return the figures behind what `judge` returns for the same arguments.

    Args:
        condition: The condition.
        known: What is known in this cycle.
        held: From the verdict on the sample before.
        is_active: Whether the alarm is active.

    Returns:
        The words.
    """
    if not isinstance(condition, _COMPOUNDS):
        return leaf_in_words(condition, known, is_on=is_active)
    return _words(condition, known, iter(parts_of(condition, held, is_active=is_active)))


def rests(condition: Condition, known: Known, held: tuple[bool, ...], *, is_active: bool) -> bool:
    """Return whether a condition surely stays as it is until a figure crosses one of its limits.

    Args:
        condition: The condition.
        known: What is known in this cycle.
        held: From the verdict on this sample.
        is_active: Whether the alarm is active.

    Returns:
        Whether it rests: until one of its figures crosses a limit, one of its targets comes or goes, another rule that
        it asks for changes, or it is `due_s`.
    """
    if not isinstance(condition, _COMPOUNDS):
        return leaf_rests(condition, known, is_active)
    return _rest(condition, known, held, [], is_active, False)[1]


def parts_of(condition: Condition, held: tuple[bool, ...], *, is_active: bool) -> tuple[Part, ...]:
    """Return the simple parts of a condition, and how `judge` judges each of them for the same arguments.

    Args:
        condition: The condition.
        held: From the verdict on the sample before.
        is_active: Whether the alarm is active.

    Returns:
        One for each, from left to right; the condition itself if it is simple.
    """
    if not isinstance(condition, _COMPOUNDS):
        return (Part(condition, is_on=is_active, is_inverted=False),)
    parts = enumerate(_listed(condition, is_inverted=False))
    return tuple(
        [Part(leaf, _is_on(held, index, is_active, is_inverted), is_inverted) for index, (leaf, is_inverted) in parts]
    )


def due_s(condition: Condition, known: Known) -> float:
    """Return when a condition may change though nothing happens until then.

    Args:
        condition: The condition.
        known: What is known in this cycle.

    Returns:
        On the run's monotonic clock; infinite for never. Schedules are not counted: they never rest.
    """
    return min((leaf_due_s(leaf, known) for leaf in leaves(condition)), default=math.inf)


def judged_by_cycle(condition: Condition) -> bool:
    """Return whether a condition is judged in every cycle, not only in those with a new frame.

    Args:
        condition: The condition.

    Returns:
        Whether any part of it may change though no frame comes.
    """
    by_cycle = (PresenceCondition, CountCondition, RuleCondition, ScheduleCondition)
    return any(isinstance(leaf, by_cycle) for leaf in leaves(condition))


def _judged(  # without keywords, which cost time: most of what a cycle costs is spent here
    condition: Condition, known: Known, held: tuple[bool, ...], memory: list[bool], is_active: bool, is_inverted: bool
) -> bool | None:
    """Return whether a part of a condition holds, and add to the memory what to remember of its simple parts."""
    if isinstance(condition, _GROUPS):
        decisive = isinstance(condition, AnyOf)
        whole: bool | None = not decisive
        for part in condition.conditions:  # to the end, since each part has a memory to keep
            value = _judged(part, known, held, memory, is_active, is_inverted)
            if value is decisive:
                whole = decisive
            elif value is None and whole is not decisive:
                whole = None
        return whole
    if isinstance(condition, Not):
        value = _judged(condition.condition, known, held, memory, is_active, not is_inverted)
        return None if value is None else not value
    is_on = _is_on(held, len(memory), is_active, is_inverted)
    value = leaf_holds(condition, known, is_on)
    memory.append(is_on if value is None else value)
    return value


def _is_on(held: tuple[bool, ...], index: int, is_active: bool, is_inverted: bool) -> bool:
    """Return whether a simple part is judged by what ends it. While it cannot be judged it remembers the same.

    While the alarm is inactive, what was before does not count: so an alarm that rests need not be judged to remember.
    """
    if not is_active:
        return is_inverted
    return held[index] if index < len(held) else not is_inverted


def _rest(
    condition: Condition, known: Known, held: tuple[bool, ...], gone: list[None], is_active: bool, is_inverted: bool
) -> tuple[bool | None, bool]:
    """Return whether a part of a condition holds, and whether it stays so; `gone` counts the parts gone through."""
    if isinstance(condition, _GROUPS):
        decisive = isinstance(condition, AnyOf)
        whole: bool | None = not decisive
        do_rest, is_decided = True, False
        for part in condition.conditions:
            value, does_rest = _rest(part, known, held, gone, is_active, is_inverted)
            if value is decisive:
                whole = decisive
                is_decided = is_decided or does_rest
            elif value is None and whole is not decisive:
                whole = None
            do_rest = do_rest and does_rest
        # One part is enough to decide; but while the alarm is active each part has a memory that may change.
        return whole, do_rest or (is_decided and not is_active)
    if isinstance(condition, Not):
        value, does_rest = _rest(condition.condition, known, held, gone, is_active, not is_inverted)
        return None if value is None else not value, does_rest
    is_on = _is_on(held, len(gone), is_active, is_inverted)
    gone.append(None)
    return leaf_holds(condition, known, is_on), leaf_rests(condition, known, is_on)


def _listed(condition: Condition, *, is_inverted: bool) -> Iterator[tuple[Leaf, bool]]:
    if isinstance(condition, _GROUPS):
        for part in condition.conditions:
            yield from _listed(part, is_inverted=is_inverted)
    elif isinstance(condition, Not):
        yield from _listed(condition.condition, is_inverted=not is_inverted)
    else:
        yield condition, is_inverted


def _words(condition: Condition, known: Known, parts: Iterator[Part]) -> str:
    if isinstance(condition, _GROUPS):
        within = "; ".join([_words(part, known, parts) for part in condition.conditions])
        return f"{'all' if isinstance(condition, AllOf) else 'any'} of ({within})"
    if isinstance(condition, Not):
        return f"not ({_words(condition.condition, known, parts)})"
    is_on = next(parts).is_on
    words = leaf_in_words(condition, known, is_on=is_on, names_target=True)
    return f"{words} [{_ANSWERS[leaf_holds(condition, known, is_on)]}]"


_ANSWERS = {True: "yes", False: "no", None: "unknown"}
