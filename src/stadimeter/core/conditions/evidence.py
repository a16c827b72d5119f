"""Conditions in words, and the figures that a verdict is explained by: each simple condition words itself."""

from __future__ import annotations

import math
from collections.abc import Iterator

from msgspec import Struct

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, JudgedLeaf, Not, judged_leaves
from stadimeter.core.conditions.leaf import ANSWERS, Leaf, RuleInputs
from stadimeter.core.words import short_figure


class Evidence(Struct, frozen=True, kw_only=True):
    """The figures that a simple condition was judged by. Those that it does not have are None.

    Attributes:
        quantity: Such as ``distance``.
        about: The targets, or the rule, that it is about; empty for the time of day and a count of all targets.
        words: The figures in words.
        holds: Whether it holds; None if that cannot be known.
        unit: The SI unit of the figures; empty for those without.
        sigma: The standard deviation of `value`, where that is known.
        low: The lower threshold that it is judged by now, deadband included.
        high: The upper threshold.
        probability: That the figure is within them.
        begin_points: The figures at which it would begin to speak for the alarm.
        end_points: The figures at which it would cease to.
    """

    quantity: str
    about: tuple[str, ...]
    words: str
    holds: bool | None
    unit: str = ""
    value: float | None = None
    sigma: float | None = None
    low: float | None = None
    high: float | None = None
    probability: float | None = None
    begin_points: tuple[float, ...] = ()
    end_points: tuple[float, ...] = ()

    @property
    def begins_at(self) -> str:
        """The figure where it would begin to speak for the alarm, such as ``1.91 m``; empty if it never would."""
        return self._points(self.begin_points)

    @property
    def ends_at(self) -> str:
        """The figure where it would cease to, such as ``2.12 m``; empty if it never would."""
        return self._points(self.end_points)

    def _points(self, points: tuple[float, ...]) -> str:
        return " or ".join(short_figure(point, self.unit) for point in points)


def describe_verdict(
    condition: Condition, inputs: RuleInputs, held: tuple[bool, ...], *, is_active: bool, with_probability: bool = False
) -> str:
    """Return the figures behind what `judge` returns for the same arguments.

    Args:
        with_probability: Whether to add how likely each part is, and from which probability on it begins or ends.
    """
    parts = iter(judged_leaves(condition, held, is_active=is_active))
    if isinstance(condition, Leaf):
        is_on = next(parts).is_on
        return condition.verdict(inputs, is_on, names_target=False, with_probability=with_probability)
    return _whole_words(condition, inputs, parts, with_probability=with_probability)


def collect_evidence(
    condition: Condition, inputs: RuleInputs, held: tuple[bool, ...], *, is_active: bool
) -> tuple[Evidence, ...]:
    """Return the figures behind what `judge` returns for the same arguments: one for each part, from left to right."""
    return tuple(_evidence(part, inputs) for part in judged_leaves(condition, held, is_active=is_active))


def _whole_words(
    condition: Condition, inputs: RuleInputs, parts: Iterator[JudgedLeaf], *, with_probability: bool
) -> str:
    if isinstance(condition, Leaf):
        part = next(parts)
        words = condition.verdict(inputs, part.is_on, names_target=True, with_probability=with_probability)
        return f"{words} [{ANSWERS[condition.holds(inputs, part.is_on)]}]"
    if isinstance(condition, Not):
        return f"not ({_whole_words(condition.condition, inputs, parts, with_probability=with_probability)})"
    within = [_whole_words(part, inputs, parts, with_probability=with_probability) for part in condition.conditions]
    return f"{'all' if isinstance(condition, AllOf) else 'any'} of ({'; '.join(within)})"


def _evidence(part: JudgedLeaf, inputs: RuleInputs) -> Evidence:
    leaf, is_on = part.leaf, part.is_on
    reading = leaf.reading(inputs, is_on)
    # Below a `not` the whole begins when this part ends.
    begin, end = (_turning_points(leaf, inputs, is_on=side) for side in (part.is_inverted, not part.is_inverted))
    return Evidence(
        quantity=leaf.noun,
        about=leaf.rules_named or leaf.targets_named,
        words=leaf.verdict(inputs, is_on, names_target=True, with_probability=True) + leaf.doubt,
        holds=leaf.holds(inputs, is_on),
        unit=leaf.unit,
        value=reading.value if reading else None,
        sigma=reading.sigma if reading else None,
        low=reading.low if reading and math.isfinite(reading.low) else None,
        high=reading.high if reading and math.isfinite(reading.high) else None,
        probability=reading.probability if reading else None,
        begin_points=begin,
        end_points=end,
    )


def _turning_points(leaf: Leaf, inputs: RuleInputs, *, is_on: bool) -> tuple[float, ...]:
    """Return the figures at which a part begins or ends; of a count, which is above n - 1, the number n itself."""
    return tuple(each + (leaf.unit == "times" and not is_on) for each in leaf.turning_points(inputs, is_on=is_on))


def describe_begin(condition: Condition) -> str:
    r"""Return a clause such as ``80% sure that \`ball\` is nearer than 0.50 m (1.6 ft)``."""
    match condition:
        case Leaf():
            words = condition.begins
            on = condition.probability_on
            return words if on is None else f"{on:.0%} sure that {words}"
        case Not():
            return f"not ({describe_begin(condition.condition)})"
        case _:
            parts = [(part, describe_begin(part)) for part in condition.conditions]
            word = " and " if isinstance(condition, AllOf) else " or "
            return word.join(f"({words})" if isinstance(part, AllOf | AnyOf) else words for part, words in parts)


def describe_end(condition: Condition) -> str:
    """Return a clause such as ``it is further than 0.50 m (1.6 ft) by 3 standard deviations of the noise``."""
    return condition.ends if isinstance(condition, Leaf) else "that has not held"
