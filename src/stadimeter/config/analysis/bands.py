"""Conditions by themselves: limits in order, with an end and without chatter, and parts that can hold together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np

from stadimeter.config.analysis import Subject
from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing
from stadimeter.core.conditions.compounds import AllOf, Condition
from stadimeter.core.conditions.leaf import IN_SIGHT, Leaf, Span
from stadimeter.core.conditions.limits import LimitsCondition, ends_of
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.quantities import QUANTITIES, noun_of
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.rule import ALWAYS, AlarmRule, AnyRule, FollowRule, RampRule, gate_of
from stadimeter.core.words import short_figure

# Targets on the floor whose distance by it cannot be: the camera's height is not known, or it sees no floor -----------

# A target whose centre is as high as the camera is level with it at every distance.
LEVEL_M = 0.01


def floor_errors(subject: Subject) -> Iterator[Finding]:
    """Find targets on the floor that the camera cannot measure by it."""
    draft = subject.draft
    standing = {name: table for name, table in draft.target_tables.items() if table.on_floor is not False}
    for name, table in standing.items():
        at = ("targets", name, "on_floor")
        if draft.camera_table.height is None:
            hint = 'measure it and add such as height = "30 cm" to [camera], or run `stadimeter calibrate floor`'
            yield Finding(at, "how high the camera is above the floor is not known", hint, "height-unknown")
        elif (footing := draft.camera_table.footing(table)) is not None and _is_level(footing):
            message = f"its centre is as high as the camera, {footing.centre_m:g} m, so the floor tells no distance"
            yield Finding(at, message, "leave on_floor out, or mount the camera higher", "floor-unseen")
    footing = next((found for table in standing.values() if (found := draft.camera_table.footing(table))), None)
    if footing is not None:
        yield from _camera(draft, footing)


def _is_level(footing: Footing) -> bool:
    centre_m, height_m = footing.centre_m, footing.height_m
    return centre_m is not None and height_m > 0 and abs(height_m - centre_m) < LEVEL_M


def _camera(draft: Draft, footing: Footing) -> Iterator[Finding]:
    if footing.height_m == 0:
        hint = 'write how high its lens is, such as height = "30 cm", or leave on_floor out'
        yield Finding(("camera", "height"), "a camera at 0 m above the floor sees none of it", hint, "floor-unseen")
    elif draft.camera_model is not None and not _is_floor_seen(draft.camera_model, footing.tilt_rad):
        message = f"looking up by {math.degrees(footing.tilt_rad):g}°, the camera has the floor below its picture"
        hint = 'below zero is down, such as tilt = "-12 deg"; or leave on_floor out'
        yield Finding(("camera", "tilt"), message, hint, "floor-unseen")
    options = draft.base.options if draft.base is not None else None
    if getattr(options, "tilt", None) is not None:
        message = "the base tilts the camera, so its tilt above the floor is not known"
        yield Finding((BASE_NAME, "tilt"), message, "leave on_floor out, or the tilt of the base", "floor-unseen")


def _is_floor_seen(lens: CameraModel, tilt_rad: float) -> bool:
    right, bottom = lens.width_px - 1.0, lens.height_px - 1.0
    corners = np.array([(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)])
    # A direction falls towards the floor where y cos t - sin t is above zero.
    return bool((lens.directions(corners)[:, 1] * math.cos(tilt_rad) > math.sin(tilt_rad)).any())


# The spans of one figure where a condition holds, or a rule acts: they tell that two never meet, or always ------------
#
# It looks at limits, deadbands and whether a target is in sight. What is made of others with `any` or `not`, and
# schedules, may meet everything: nothing is said of these.


def span_of(condition: Condition) -> Span | None:
    """Return where a simple condition holds; None for one of which nothing is said."""
    return condition.span if isinstance(condition, Leaf) else None


def range_of(rule: AnyRule) -> Span | None:
    """Return where a rule would act if its gate were open; None where that is no single span."""
    if isinstance(rule, AlarmRule):
        return span_of(rule.condition)
    if isinstance(rule, FollowRule):
        return Span((IN_SIGHT, rule.target), 0.0, math.inf)
    if not isinstance(rule, RampRule) or rule.points:
        return None
    begins = _begins(rule)
    low, high = (begins, math.inf) if rule.full > rule.start else (-math.inf, begins)
    return span_of(FigureCondition(quantity=rule.quantity, above=low, below=high, target=rule.target))


def is_always_open(rule: AnyRule) -> bool:
    """Check whether nothing but its range keeps a rule from acting."""
    gate = gate_of(rule)
    return gate.suppress_when is None and (isinstance(rule, AlarmRule) or gate.condition is ALWAYS)


def parts_of_all(written: WrittenCondition) -> Iterator[WrittenCondition]:
    """Yield the conditions that must hold together: a condition itself, or the parts of an `all`."""
    if not isinstance(written.condition, AllOf):
        yield written
        return
    for part in written.parts():
        yield from parts_of_all(part)


def _begins(ramp: RampRule) -> float:
    """Return where the level comes out of the dead zone."""
    if ramp.dead_zone <= ramp.level_min:
        return ramp.start
    if ramp.dead_zone >= ramp.level_max:
        return ramp.full
    share = math.pow((ramp.dead_zone - ramp.level_min) / (ramp.level_max - ramp.level_min), 1 / ramp.gamma)
    return ramp.start + share * (ramp.full - ramp.start)


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
    hint = 'add such as height = "1.2 m" to [camera], or write axis = "height_above_camera"'
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
    """Find conditions that can never hold, and gates that are open only where their rule does nothing."""
    for declared in subject.rules:
        for written in declared.conditions():
            for part in parts_of_all(written):
                yield from _never(part, len(subject.draft.target_names))
            if not any(empty_leaves(written)):  # reported by `band_errors`
                yield from _never_together(written)
        yield from _shut(declared)


def _never(leaf: WrittenCondition, targets: int) -> Iterator[Finding]:
    """Find counts of more targets than there are, and figures that are never below zero."""
    condition = leaf.condition
    if not isinstance(condition, Leaf):
        return
    if isinstance(condition, CountCondition):
        least, most = ends_of(condition.at_least, condition.at_most)
        is_never = len(condition.targets or range(targets)) < least <= most
    else:
        low, high = condition.limits
        is_never = low < high <= 0 and not condition.is_signed
    if is_never:
        message = f"{leaf} can never hold"
        yield Finding(leaf.path, message, "change one of its limits, or leave the rule out", "never-true")


def _never_together(written: WrittenCondition) -> Iterator[Finding]:
    """Find the first two parts of an `all` that exclude each other; below `any` or `not` that does no harm."""
    parts = [(part, span) for part in parts_of_all(written) if (span := span_of(part.condition)) is not None]
    for (first, one), (second, other) in combinations(parts, 2):
        if not one.meets(other):
            message = f"{first} and {second} never hold together, so the condition never does"
            hint = "write any in place of all if one of them is enough, or change a limit"
            yield Finding(written.path, message, hint, "never-true")
            return


def _shut(declared: CompiledRule) -> Iterator[Finding]:
    """Find gates that are open only where their rule would do nothing."""
    rule, acts = declared.rule, range_of(declared.rule)
    if isinstance(rule, AlarmRule) or acts is None:
        return
    gates = (part for each in declared.conditions() if each.path[-1] == "when" for part in parts_of_all(each))
    spans: list[Span | None] = [span_of(part.condition) for part in gates]
    if any(span is not None and not span.meets(acts) for span in spans):
        kind = "ramp" if isinstance(rule, RampRule) else "follow"
        message = f"wherever this holds, the {kind} of '{declared.section}' does nothing: it never acts"
        hint = f"let when hold where the {kind} acts, or leave it out"
        yield Finding(declared.at("when"), message, hint, "shut-gate")
