"""The limits of one condition against each other: in order, with an end, and without chatter."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stadimeter.config.analysis.subject import Subject
from stadimeter.config.analysis.written import WrittenCondition
from stadimeter.config.findings import Finding


def band_errors(subject: Subject) -> Iterator[Finding]:
    """Find limits that are not in order, bands that never end, and probabilities that make an alarm chatter.

    Args:
        subject: The configuration.

    Yields:
        What is wrong.
    """
    for declared, _ in subject.alarms:
        for written in declared.conditions():
            yield from empty_leaves(written)
            for leaf in written.leaves():
                yield from _without_end(leaf)
                yield from _probabilities(leaf)


def empty_leaves(written: WrittenCondition) -> Iterator[Finding]:
    """Find simple conditions between two limits that are not in order.

    Args:
        written: A condition.

    Yields:
        What is wrong.
    """
    for leaf in written.leaves():
        quantity = leaf.leaf.band()
        if quantity is None or quantity.low is None or quantity.high is None or quantity.low < quantity.high:
            continue
        if quantity.noun == "count":
            message = f"no count is at least {quantity.low + 0.5:g} and at most {quantity.high - 0.5:g}"
            yield Finding(leaf.limits_path, message, "exchange the two", "empty-interval")
            continue
        unit = f" {quantity.unit}"
        message = f"no {quantity.noun} is above {quantity.low:g}{unit} and below {quantity.high:g}{unit}"
        if "between" in _table_of(leaf):
            near = "nearer" if quantity.is_positive else "lower"
            yield Finding((*leaf.limits_path, "between"), message, f"write the {near} end first", "empty-interval")
        else:
            yield Finding(leaf.limits_path, message, "exchange the two, or make two rules of them", "empty-interval")


def _without_end(leaf: WrittenCondition) -> Iterator[Finding]:
    quantity = leaf.leaf.band()
    if quantity is None or not quantity.is_positive or quantity.low is None or quantity.high is not None:
        return
    if quantity.deadband >= quantity.low:
        message = f"with a deadband of {quantity.deadband:g} m above {quantity.low:g} m the alarm could never clear"
        yield Finding((*leaf.limits_path, "deadband"), message, "make it smaller than the limit", "band-inverted")


def _probabilities(leaf: WrittenCondition) -> Iterator[Finding]:
    on: float | None = getattr(leaf.leaf, "probability_on", None)
    off: float | None = getattr(leaf.leaf, "probability_off", None)
    if on is not None and off is not None and off > on:
        message = f"probability_off {off:g} is above probability {on:g}: the alarm would chatter"
        yield Finding((*leaf.limits_path, "probability_off"), message, "exchange the two", "band-inverted")


def _table_of(leaf: WrittenCondition) -> Any:
    table: Any = leaf.table
    for key in leaf.limits_path[len(leaf.path) :]:
        table = table[key]
    return table
