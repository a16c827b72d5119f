"""The memory over a window of time: counts and sums that cannot be, figures, and messages at times."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stadimeter.config.analysis import Subject
from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding
from stadimeter.config.rules.tables import RuleTable
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.alarms.state import MINUTE_S
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.summary import SLOTS
from stadimeter.core.rule import AlarmRule, AnyRule, ReportRule
from stadimeter.core.rules.report import LATE_S

_STEP_KEYS = ("actuator", "after", "on", "only_unacknowledged")


def memory_errors(subject: Subject) -> Iterator[Finding]:
    """Find sums longer than their window, figures of no target or in another unit, and messages that are none.

    Messages at times are never active, so that nothing can wait for them or count them.
    """
    messages = {each.rule.name for each in subject.rules if isinstance(each.rule, ReportRule)}
    for leaf in subject.leaves:
        condition = leaf.leaf
        for name in sorted(messages.intersection(condition.rules_named)):
            message = f"'{name}' sends messages at its times, and is never active"
            yield Finding(leaf.limits_path, message, "name a rule that has when, ramp or follow", "never-true")
        if not isinstance(condition, RememberedCondition):
            continue
        longest_s = condition.window.for_s * (SLOTS - 1) / SLOTS
        if condition.unit == "s" and (condition.above or 0.0) >= longest_s and condition.rules:
            message = f"no rule is active for {condition.above:g} s {condition.window}: {longest_s:g} s at most"
            yield Finding((*leaf.limits_path, "at_least"), message, "write a longer window", "never-true")
        figure = subject.draft.figures.get(condition.name)
        if figure is not None and condition.unit and condition.unit != (unit := QUANTITIES[figure.of].unit):
            message = f"the figure '{condition.name}' is in {unit}, and not in {condition.unit}"
            yield Finding(leaf.limits_path, message, f"write its limits in {unit}", "bad-value")
    yield from _figures(subject.draft)
    for declared in subject.rules:
        if isinstance(declared.rule, ReportRule):
            yield from _report(declared.path, subject.draft.rules[declared.section])


def _figures(draft: Draft) -> Iterator[Finding]:
    names = draft.names("targets")
    for name, figure in draft.figures.items():
        if figure.target is None and len(names) > 1:
            message = f"which of the targets {', '.join(draft.tables('targets'))} is '{name}' of?"
            yield Finding(("figures", name, "target"), message, draft.any_target_hint, "target-missing")
        elif figure.target is not None and figure.target not in draft.target_names:
            hint = draft.target_hint(figure.target)
            yield Finding(("figures", name, "target"), f"there is no target '{figure.target}'", hint, "unknown-name")


def memory_warnings(subject: Subject) -> Iterator[Finding]:
    """Find counts that are never reached, however often the rule that is counted would be raised."""
    rules = {each.rule.name: each.rule for each in subject.every_rule}
    for leaf in subject.leaves:
        condition = leaf.leaf
        if not isinstance(condition, RememberedCondition):
            continue
        most = sum(_raises_max(rules.get(name), condition.window.for_s) for name in condition.rules)
        if condition.unit == "times" and (condition.above or 0.0) >= most:
            message = f"{' or '.join(condition.rules)} can be raised {most:g} times {condition.window} at most"
            hint = "count fewer; on_delay, off_delay and raises_per_min_max of that rule limit it"
            yield Finding((*leaf.limits_path, "at_least"), message, hint, "never-true")


def _raises_max(rule: AnyRule | None, for_s: float) -> float:
    """Count how often a rule can be raised within a window: by its delays, and by its limit on chattering."""
    if not isinstance(rule, AlarmRule):
        return math.inf
    period_s, most = rule.on_delay.hold_s + rule.off_delay_s, rule.raises_per_min_max
    by_delays = math.ceil(for_s / period_s) if period_s else math.inf
    return min(by_delays, most * math.ceil(for_s / MINUTE_S) if most else math.inf)


def _report(at: KeyPath, rule: RuleTable) -> Iterator[Finding]:
    """Find messages at times that would drive something, say nothing, or come twice in one moment."""
    wrong: list[KeyPath] = [(*at, "actuator")] if rule.actuator is not None else []
    for number, step in enumerate(rule.escalation):
        wrong += [(*at, "escalation", number, key) for key in _STEP_KEYS if key in step.model_fields_set]
    for path in wrong:
        message = f"'{path[-1]}' has no meaning beside every or at: such a rule sends at its times, and no more"
        yield Finding(path, message, "leave it out", "key-of-another-kind")
    if not rule.steps:
        yield Finding(at, f"the rule '{at[-1]}' sends nothing", "add notify, or a step with topic", "missing-key")
    times = sorted(rule.at or [0.0])
    if any(later - time < 2 * LATE_S for time, later in zip(times, [*times[1:], times[0] + DAY_S], strict=True)):
        yield Finding((*at, "at"), "two of the times are less than 2 min apart", "leave one out", "bad-value")
