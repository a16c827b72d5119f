"""Quantities of targets that cannot be known, targets that are compared with themselves, and the ends of ramps."""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.config.analysis import Subject
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.core.conditions.measured import ComparisonCondition, FigureCondition
from stadimeter.core.conditions.quantities import QUANTITIES, noun_of
from stadimeter.core.rule import RampRule
from stadimeter.core.words import short_figure


def quantity_errors(subject: Subject) -> Iterator[Finding]:
    """Find ramps whose ends are not in order, targets compared with themselves, and heights above an unknown floor."""
    for declared in subject.every_rule:
        for written in declared.conditions():
            for leaf in written.leaves():
                yield from _with_itself(leaf)
    for declared in subject.rules:
        heights = [
            leaf.limits_path
            for written in declared.conditions()
            for leaf in written.leaves()
            if isinstance(leaf.condition, FigureCondition) and leaf.condition.quantity == "height"
        ]
        if isinstance(declared.rule, RampRule):
            yield from _ramp(declared, declared.rule)
            heights += [declared.at("ramp", "of")] if declared.rule.quantity == "height" else []
        for path in heights if subject.draft.camera_table.height is None else []:
            hint = 'add such as height = "1.2 m" to [camera], or write height_above_camera'
            yield Finding(path, "how high the camera is above the floor is not known", hint, "height-unknown")


def _ramp(declared: CompiledRule, ramp: RampRule) -> Iterator[Finding]:
    if ramp.points:  # they are checked as they are read
        return
    if ramp.start == ramp.full:
        start = short_figure(ramp.start, QUANTITIES[ramp.quantity].unit)
        message = f"the ramp goes from {start} to the same {noun_of(ramp.quantity)}"
        yield Finding(declared.at("ramp"), message, "choose two figures, or write a rule with when", "ramp-reversed")
    if ramp.level_min > ramp.level_max:
        message = f"min {ramp.level_min:g} is above max {ramp.level_max:g}"
        hint = "exchange them; from and to give the direction"
        yield Finding(declared.at("ramp", "min"), message, hint, "ramp-reversed")


def _with_itself(leaf: WrittenCondition) -> Iterator[Finding]:
    condition = leaf.condition
    if isinstance(condition, ComparisonCondition) and condition.target == condition.other:
        key = condition.comparison
        message = f"'{condition.other}' is never {key.replace('_', ' ')} itself"
        yield Finding((*leaf.path, key), message, "name another target", "condition-keys")
