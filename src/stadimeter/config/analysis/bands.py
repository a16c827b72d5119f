"""Conditions by themselves: limits in order, with an end and without chatter; never or always met, or suppressed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, islice
from typing import Any

from stadimeter.config.analysis import Subject
from stadimeter.config.analysis.logic import Goal, Logic, Wanted
from stadimeter.config.analysis.regions import beginning_of, range_of, region_of
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.conditions.compounds import AllOf, Condition
from stadimeter.core.conditions.discrete import CountCondition, PresenceCondition
from stadimeter.core.conditions.limits import LimitsCondition, ends_of
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.quantities import QUANTITIES, noun_of
from stadimeter.core.rule import AlarmRule, LostPolicy, RampRule, gate_of
from stadimeter.core.words import short_figure

# Pairs of parts that are tried at most to name the two that clash: those of some sixty parts.
_MAX_PAIRS = 2000


def band_errors(subject: Subject) -> Iterator[Finding]:
    """Find limits that are not in order, bands that never end, and probabilities that make an alarm chatter."""
    for declared in subject.rules:
        for written in declared.conditions():
            yield from empty_leaves(written)
            for leaf in written.leaves():
                yield from _without_end(leaf)
                yield from _probabilities(leaf)


def empty_leaves(written: WrittenCondition) -> Iterator[Finding]:
    """Find simple conditions between two limits that are not in order."""
    for leaf in written.leaves():
        condition = leaf.leaf
        if isinstance(condition, CountCondition):
            least, most = ends_of(condition.at_least, condition.at_most)
            if least > most:
                message = f"no count is at least {least:g} and at most {most:g}"
                yield Finding(leaf.limits_path, message, "exchange the two", "empty-interval")
            continue
        low, high = condition.limits
        if low < high:
            continue
        scale, unit = (math.degrees(1), "deg") if condition.unit == "rad" else (1.0, condition.unit)
        message = f"no {condition.noun} is above {low * scale:g} {unit} and below {high * scale:g} {unit}"
        if "between" in _table_of(leaf):
            near = "nearer" if condition.unit == "m" else "lower"
            yield Finding((*leaf.limits_path, "between"), message, f"write the {near} end first", "empty-interval")
        else:
            yield Finding(leaf.limits_path, message, "exchange the two, or make two rules of them", "empty-interval")


def _without_end(leaf: WrittenCondition) -> Iterator[Finding]:
    condition = leaf.leaf
    if isinstance(condition, LimitsCondition) and not condition.can_end:
        message = (
            f"with a deadband of {condition.deadband:g} m above {condition.limits[0]:g} m the alarm could never clear"
        )
        yield Finding((*leaf.limits_path, "deadband"), message, "make it smaller than the limit", "band-inverted")


def _probabilities(leaf: WrittenCondition) -> Iterator[Finding]:
    on, off = leaf.leaf.probability_on, leaf.leaf.probability_off
    if on is not None and off > on:
        message = f"probability_off {off:g} is above probability {on:g}: the alarm would chatter"
        yield Finding((*leaf.limits_path, "probability_off"), message, "exchange the two", "band-inverted")


def _table_of(leaf: WrittenCondition) -> Any:
    table: Any = leaf.table
    for key in leaf.limits_path[len(leaf.path) :]:
        table = table[key]
    return table


def quantity_errors(subject: Subject) -> Iterator[Finding]:
    """Find ramps whose ends are not in order, targets compared with themselves, and heights above an unknown floor."""
    heights: dict[KeyPath, str] = {("figures", name, "of"): each.of for name, each in subject.draft.figures.items()}
    for declared in subject.every_rule:
        leaves = [leaf for written in declared.conditions() for leaf in written.leaves()]
        for leaf in leaves:
            yield from _with_itself(leaf)
        heights |= {leaf.limits_path: getattr(leaf.condition, "quantity", "") for leaf in leaves}
        if isinstance(declared.rule, RampRule):
            yield from _ramp(declared, declared.rule)
            heights[declared.at("ramp", "of")] = declared.rule.quantity
    hint = 'add such as height = "1.2 m" to [camera], or write height_above_camera'
    for path in [path for path, quantity in heights.items() if quantity == "height"]:
        if subject.draft.camera_table.height is None:
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
    if isinstance(condition, FigureCondition) and condition.is_comparison and condition.target == condition.other:
        key = condition.comparison
        message = f"'{condition.other}' is never {key.replace('_', ' ')} itself"
        yield Finding((*leaf.path, key), message, "name another target", "condition-keys")


def holding_errors(subject: Subject) -> Iterator[Finding]:
    """Find conditions that can never hold."""
    for declared in subject.rules:
        for written in declared.conditions():
            if not any(empty_leaves(written)):  # reported by `band_errors`
                yield from _never(written, subject.logic)
        yield from _shut(declared, subject.logic)


def _shut(declared: CompiledRule, logic: Logic) -> Iterator[Finding]:
    """Find gates that are open only where their rule would do nothing."""
    rule = declared.rule
    if isinstance(rule, AlarmRule) or logic.can_be((region_of(rule), Wanted.TRUE)):
        return
    if logic.can_be((rule.gate.condition, Wanted.TRUE)) and logic.can_be((range_of(rule), Wanted.TRUE)):
        kind = "ramp" if isinstance(rule, RampRule) else "follow"
        message = f"wherever this holds, the {kind} of '{declared.section}' does nothing: it never acts"
        yield Finding(
            declared.at("when"), message, f"let when hold where the {kind} acts, or leave it out", "shut-gate"
        )


def holding_warnings(subject: Subject) -> Iterator[Finding]:
    """Find conditions that never cease to hold, and suppressions that meet their rule always."""
    for declared in subject.rules:
        for written in declared.conditions():
            yield from _always(declared, written, subject.logic)
        yield from _left_out(declared, subject.logic)
        suppress_when = gate_of(declared.rule).suppress_when
        if suppress_when is not None and _meets_always(region_of(declared.rule), suppress_when, subject.logic):
            message = (
                f"whenever '{declared.section}' holds, it is suppressed: it never drives and never notifies anything"
            )
            hint = "suppress it in fewer situations, or write observe = true if that is meant"
            yield Finding(declared.at("suppress_when"), message, hint, "always-suppressed")


def _left_out(declared: CompiledRule, logic: Logic) -> Iterator[Finding]:
    """Find steps that are due when their alarm is raised, and whose condition cannot hold then."""
    alarm = declared.rule
    if not isinstance(alarm, AlarmRule) or alarm.lost.policy is LostPolicy.ASSERT:
        return
    for number, step in enumerate(alarm.escalation):
        if step.when is None or step.on != "raised" or step.after_s > 0:
            continue
        goals: list[Goal] = [
            (alarm.condition, Wanted.TRUE),
            (step.when, Wanted.NOT_FALSE if step.send else Wanted.TRUE),
        ]
        if all(logic.can_be(goal) for goal in goals) and not logic.can_be(*goals):
            message = f"when '{alarm.name}' is raised, this does not hold: the step is left out"
            hint = 'write such as after = "10 s" if it may hold later, or leave the step out'
            yield Finding(declared.at("escalation", number, "when"), message, hint, "never-true")


def _meets_always(condition: Condition, suppression: Condition, logic: Logic) -> bool:
    """Return whether a suppression that does not always hold does so wherever the condition holds."""
    can_be_free = logic.can_be((suppression, Wanted.FALSE))
    can_hold = logic.can_be((condition, Wanted.TRUE))
    return can_be_free and can_hold and not logic.can_be((condition, Wanted.TRUE), (suppression, Wanted.NOT_TRUE))


def _can_begin(logic: Logic, *written: WrittenCondition) -> bool:
    return logic.can_be(*((beginning_of(each.condition), Wanted.TRUE) for each in written))


def _never(written: WrittenCondition, logic: Logic) -> Iterator[Finding]:
    if _can_begin(logic, written):
        return
    blamed = next((part for part in written.parts() if not _can_begin(logic, part)), None)
    if blamed is not None and isinstance(written.condition, AllOf):
        yield from _never(blamed, logic)
        return
    clash = _clash(written, logic)
    if clash is None:
        message = f"{written} can never hold"
        yield Finding(written.path, message, "change one of its limits, or leave the rule out", "never-true")
    else:
        message = f"{clash[0]} and {clash[1]} never hold together, so the condition never does"
        hint = "write any in place of all if one of them is enough, or change a limit"
        yield Finding(written.path, message, hint, "never-true")


def _clash(written: WrittenCondition, logic: Logic) -> tuple[WrittenCondition, WrittenCondition] | None:
    """Return two parts of an ``all`` that cannot hold together, if two alone are enough for that."""
    if not isinstance(written.condition, AllOf):
        return None
    pairs = islice(combinations(written.parts(), 2), _MAX_PAIRS)
    return next((pair for pair in pairs if not _can_begin(logic, *pair)), None)


def _always(declared: CompiledRule, written: WrittenCondition, logic: Logic) -> Iterator[Finding]:
    if logic.can_be((written.condition, Wanted.FALSE)) or not logic.can_be((written.condition, Wanted.TRUE)):
        return
    if written.path[-1] == "suppress_when":
        message = f"{written} always holds: the rule is suppressed for ever"
    else:
        where = "at all times" if _knows_always(written) else "wherever it is known"
        is_alarm = isinstance(declared.rule, AlarmRule) and len(written.path) == len(declared.at("when"))
        effect = "once raised, the alarm does not end" if is_alarm else "it holds nothing back"
        message = f"{written} holds {where}: {effect}"
    hint = "write all in place of any if both are meant together, or change a limit"
    yield Finding(written.path, message, hint, "always-true")


def _knows_always(written: WrittenCondition) -> bool:
    return all(isinstance(leaf.leaf, PresenceCondition) for leaf in written.leaves())
