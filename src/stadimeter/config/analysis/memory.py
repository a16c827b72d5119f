"""What is remembered over a window of time: counts and sums that cannot be, figures, and messages at times."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

from stadimeter.config.analysis import Subject
from stadimeter.config.findings import Finding, did_you_mean_or_list
from stadimeter.config.rules.compiled import WrittenCondition
from stadimeter.config.rules.tables import RuleTable
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.units import parse_any_quantity
from stadimeter.core.alarms.state import MINUTE_S
from stadimeter.core.conditions.tallies import ActiveForCondition, RaisedCondition
from stadimeter.core.conditions.window import DAY_S
from stadimeter.core.remembered import QUANTITIES
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.rules.report import LATE_S
from stadimeter.core.words import duration, time_of_day

_LIMITS = ("above", "below", "between", "deadband")
_STEP_KEYS = ("actuator", "after", "on", "only_unacknowledged")


def memory_errors(subject: Subject) -> Iterator[Finding]:
    """Find sums longer than their window, figures of no target or in another unit, and messages that are none."""
    for declared, _ in subject.alarms:
        for written in declared.conditions():
            for leaf in written.leaves():
                yield from _sum_too_long(leaf)
                yield from _units(subject, leaf)
    yield from _figures(subject)
    yield from _reports(subject)


def memory_warnings(subject: Subject) -> Iterator[Finding]:
    """Find counts that are never reached, however often the rule that is counted would be raised."""
    rules = {each.rule.name: each.rule for each in subject.every_rule}
    for declared, _ in subject.alarms:
        for written in declared.conditions():
            for leaf in written.leaves():
                condition = leaf.leaf
                if isinstance(condition, RaisedCondition):
                    most = sum(_raises_max(rules.get(name), condition.window.for_s) for name in condition.rules)
                    if condition.at_least > most:
                        yield _never_counted(leaf, condition, int(most))


def _sum_too_long(leaf: WrittenCondition) -> Iterator[Finding]:
    condition = leaf.leaf
    if isinstance(condition, ActiveForCondition) and condition.at_least_s > condition.window.for_s:
        message = f"no rule is active for {duration(condition.at_least_s)} {condition.window}"
        yield Finding(
            (*leaf.limits_path, "at_least"), message, "write a longer window, or a shorter time", "never-true"
        )


def _raises_max(rule: AnyRule | None, for_s: float) -> float:
    """Return how often a rule can be raised within a window: by its delays, and by its limit on chattering."""
    if not isinstance(rule, AlarmRule):
        return math.inf
    period_s, most = rule.on_delay.hold_s + rule.off_delay_s, rule.raises_per_min_max
    by_delays = math.floor(for_s / period_s) + 1 if period_s else math.inf
    return min(by_delays, most * math.ceil(for_s / MINUTE_S) if most else math.inf)


def _never_counted(leaf: WrittenCondition, condition: RaisedCondition, most: int) -> Finding:
    named = " or ".join(f"'{rule}'" for rule in condition.rules)
    message = f"{named} can be raised {most} times {condition.window} at most, and not {condition.at_least} times"
    hint = "write a smaller at_least or a longer window; on_delay, off_delay and raises_per_min_max of it limit this"
    return Finding((*leaf.limits_path, "at_least"), message, hint, "never-true")


def _units(subject: Subject, leaf: WrittenCondition) -> Iterator[Finding]:
    written = leaf.table.get("figure")
    figure = subject.draft.figures.get(written.get("name", "")) if isinstance(written, dict) else None
    if figure is None or written is None:
        return
    unit = QUANTITIES[figure.of][0]
    limits = [(key, text) for key in _LIMITS for text in _listed(written.get(key))]
    for key, found in [(key, parse_any_quantity(text)[1]) for key, text in limits]:
        if found != unit:
            message = f"the figure '{written['name']}' is in {unit}, and not in {found}"
            yield Finding((*leaf.limits_path, key), message, f"write it in {unit}", "bad-value")


def _listed(value: object) -> list[str]:
    found = value if isinstance(value, list) else [value]
    return [text for text in found if isinstance(text, str)]


def _figures(subject: Subject) -> Iterator[Finding]:
    draft, names = subject.draft, subject.draft.names("targets")
    for name, figure in draft.figures.items():
        at = ("figures", name, "target")
        if figure.target is None and len(names) > 1:
            message = f"which of the targets {', '.join(names)} is the figure '{name}' of?"
            yield Finding(at, message, f'add target = "{names[0]}"', "target-missing")
        elif figure.target is not None and figure.target not in draft.target_names:
            hint = did_you_mean_or_list(figure.target, draft.target_names)
            yield Finding(at, f"there is no target '{figure.target}'", hint, "unknown-name")


def _reports(subject: Subject) -> Iterator[Finding]:
    """Find messages at times that would drive something, say nothing, or come twice in one moment."""
    for section, rule in subject.draft.rules.items():
        if rule.every is not None or rule.at is not None:
            yield from _steps(("rules", section), rule)
            yield from _times(("rules", section, "at"), sorted(rule.at or ()))


def _steps(at: KeyPath, rule: RuleTable) -> Iterator[Finding]:
    wrong: list[KeyPath] = [(*at, "actuator")] if rule.actuator is not None else []
    for number, step in enumerate(rule.escalation):
        wrong += [(*at, "escalation", number, key) for key in _STEP_KEYS if key in step.model_fields_set]
    for path in wrong:
        message = (
            f"'{path[-1]}' has a meaning only in a rule with when: this one sends at its times, and drives nothing"
        )
        yield Finding(path, message, "leave it out", "key-of-another-kind")
    if not rule.steps:
        yield Finding(at, f"the rule '{at[-1]}' sends nothing", "add notify, or a step with topic", "missing-key")


def _times(at: KeyPath, times: list[float]) -> Iterator[Finding]:
    for first, second in pairwise([*times, *(each + DAY_S for each in times[:1])]):
        if second - first < 2 * LATE_S:
            message = f"{time_of_day(first)} and {time_of_day(second)} are less than {duration(2 * LATE_S)} apart"
            yield Finding(at, message, "leave one of them out", "bad-value")
