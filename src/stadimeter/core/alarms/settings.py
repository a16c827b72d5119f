"""The settings of a rule that an operator may change while it runs: its thresholds, and whether it is observed only.

A rule is judged as it is set. What was set is in the alarm's record, with what the configuration says in place of it.
Values are bounded as those of a configuration are: by the quantity, by the other end of an interval, by the deadband.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.alarms.machine import AlarmRecord
from stadimeter.core.alarms.state import SetThreshold
from stadimeter.core.bounds import MIN_QUANTITY
from stadimeter.core.conditions.compounds import leaves, named_leaves, with_leaves
from stadimeter.core.conditions.leaf import Leaf, Threshold
from stadimeter.core.decision import Severity
from stadimeter.core.rule import AlarmRule
from stadimeter.core.words import figure_in_words, rounded_duration


class RuleThreshold(NamedTuple):
    """A threshold of a rule as it is now."""

    leaf: int
    """Which of the simple parts of its condition has it, from left to right."""
    place: Threshold
    unit: str
    value: float

    def takes(self, value: float) -> bool:
        """Check whether it may have a value; not NaN."""
        is_zero_or_quantity = value == 0 or abs(value) >= MIN_QUANTITY
        return is_zero_or_quantity and self.place.low <= value <= self.place.high

    @property
    def range_in_words(self) -> str:
        """The range it takes, in its SI unit."""
        return f"{self.place.low:.6g} to {self.place.high:.6g} {self.unit}"


class ThresholdSetting(Struct, frozen=True, kw_only=True):
    """A threshold of a rule as others see it, in the SI unit.

    Attributes:
        configured: What the configuration says.
        min: The least value that it takes now.
        set_by: Who has set it; None for no one.
    """

    value: float
    configured: float
    unit: str
    min: float
    max: float
    set_by: str | None


def thresholds_of(rule: AlarmRule) -> dict[str, RuleThreshold]:
    """Return the thresholds of a rule that can be moved, by their names.

    A name follows the keys of `when`, such as ``below`` or ``closing_speed.above``. If several parts have the same, it
    begins with where the part stands: ``any.0.below``.
    """
    parts = list(named_leaves(rule.condition))
    times = Counter(place.key for _, leaf in parts for place in leaf.thresholds)
    return {
        (place.key if times[place.key] == 1 else within + place.key): RuleThreshold(
            number, place, leaf.unit, getattr(leaf, place.field)
        )
        for number, (within, leaf) in enumerate(parts)
        for place in leaf.thresholds
    }


def move(rule: AlarmRule, values: Mapping[str, float]) -> AlarmRule:
    """Return a rule with other thresholds, by their names; a name that it does not have is passed over."""
    found, parts = thresholds_of(rule), list[Any](leaves(rule.condition))
    for key in values.keys() & found.keys():
        parts[found[key].leaf] = replace(parts[found[key].leaf], **{found[key].place.field: values[key]})
    moved: list[Leaf] = parts
    return replace(rule, condition=with_leaves(rule.condition, iter(moved)))


def as_set(rule: AlarmRule, record: AlarmRecord) -> AlarmRule:
    """Return a rule as it is judged: that of the configuration, with what an operator has set."""
    if record.inhibits.is_observed:
        rule = replace(rule, observe=True)
    return move(rule, {each.key: each.value for each in record.thresholds}) if record.thresholds else rule


def keep_thresholds(
    rule: AlarmRule, found: tuple[SetThreshold, ...]
) -> tuple[tuple[SetThreshold, ...], tuple[SetThreshold, ...]]:
    """Return which thresholds stay set for a rule of the configuration, and which do not.

    One stays while the configuration says the same in place of it, and takes it.
    """
    known = thresholds_of(rule) if rule.severity is not Severity.SAFETY else {}
    kept = tuple(each for each in found if each.key in known and known[each.key].value == each.configured)
    now = thresholds_of(move(rule, {each.key: each.value for each in kept})) if kept else {}
    if not all(now[each.key].takes(each.value) for each in kept):
        kept = ()
    return kept, tuple(each for each in found if each not in kept)


def show_thresholds(rule: AlarmRule, record: AlarmRecord) -> dict[str, ThresholdSetting]:
    """Return the thresholds of a rule as others see them, by their names.

    Args:
        rule: The rule as it is judged.
    """
    was_set = {each.key: each for each in record.thresholds}
    return {
        key: ThresholdSetting(
            value=found.value,
            configured=was_set[key].configured if key in was_set else found.value,
            unit=found.unit,
            min=found.place.low,
            max=found.place.high,
            set_by=(was_set[key].by or "an operator") if key in was_set else None,
        )
        for key, found in thresholds_of(rule).items()
    }


def describe_thresholds(record: AlarmRecord, now_s: float) -> tuple[str, ...]:
    """Return which thresholds are set, by whom and when, and what the configuration says; empty for none."""
    return tuple(
        f"`{each.key}` is {figure_in_words(each.value, each.unit)}, set by {each.by or 'an operator'} "
        f"{rounded_duration(now_s - each.at_s)} ago, where the configuration says "
        f"{figure_in_words(each.configured, each.unit)}"
        for each in record.thresholds
    )
