"""Names of other rules, targets, actuators and notifiers that must exist, and no rule that waits for itself.

Read from the tables as they were written, so that a rule with a mistake elsewhere is checked too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from typing import Any

from msgspec import Struct

from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding, did_you_mean_or_list
from stadimeter.config.models import ButtonTable
from stadimeter.config.rules.conditions import KEYS_ABOUT_WHOM, KEYS_OF_GROUPS
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.conditions.measured import COMPARISONS
from stadimeter.core.rule import AlarmRule, gate_of
from stadimeter.core.words import duration
from stadimeter.operator_actions import OperatorAction

# A longer ring is written with a gap.
_MAX_NAMES = 8

# More rings are found once these are mended: each takes a walk through all rules.
_MAX_RINGS = 50

_CONDITIONS = ("when", "suppress_when")

# What only an alarm can be told; a ramp, or a rule that follows, is kept quiet like one.
_OF_ALARMS = frozenset({OperatorAction.ACKNOWLEDGE, OperatorAction.RESET})


class _Name(Struct, frozen=True):
    """A name that stands in a condition."""

    kind: str
    name: str
    path: KeyPath


def reference_errors(draft: Draft) -> Iterator[Finding]:
    """Find names that stand for nothing, and rules that wait for themselves."""
    rules, targets = set(_rule_names(draft)), draft.target_names
    known = {"rule": rules, "target": set(targets), "figure": set(draft.names("figures"))}
    known["counted"] = {*targets, *draft.groups}
    for section, table in draft.tables("rules").items():
        for name in _names(section, table):
            if name.name not in known[name.kind]:
                is_target = name.kind in {"target", "counted"}
                message = f"there is no {'target' if is_target else name.kind} '{name.name}'"
                hint = draft.target_hint(name.name) if is_target else did_you_mean_or_list(name.name, known[name.kind])
                yield Finding(name.path, message, hint, "unknown-name")
        yield from _steps(draft, section, table)
    yield from _groups(draft)
    yield from _buttons(draft)
    yield from _cycles(draft)


def rules_asked_for(draft: Draft) -> frozenset[str]:
    """Return the rules that conditions of others ask for."""
    sections = draft.tables("rules")
    return frozenset(
        _section_of(name, sections)
        for section, table in sections.items()
        for name in _rules_in(section, table)
        if name.name != section
    )


def _rule_names(draft: Draft) -> Iterator[str]:
    for section, table in draft.tables("rules").items():
        yield section
        targets = table.get("targets")
        if isinstance(targets, list):
            names = draft.expanded(target for target in targets if isinstance(target, str))
            yield from (f"{section}:{target}" for target in names)


def condition_tables_of(section: str, table: Mapping[str, Any]) -> Iterator[tuple[KeyPath, Any]]:
    """Go through the conditions of a rule as they were written, and where each stands."""
    yield from ((("rules", section, key), table.get(key)) for key in _CONDITIONS)
    steps = table.get("escalation")
    for number, step in enumerate(steps if isinstance(steps, list) else ()):
        if isinstance(step, Mapping):
            yield ("rules", section, "escalation", number, "when"), step.get("when")


def _names(section: str, table: Mapping[str, Any]) -> Iterator[_Name]:
    """Go through the names in the conditions of a rule, however deep these are nested."""
    left: list[tuple[KeyPath, Any]] = [*reversed(list(condition_tables_of(section, table)))]
    while left:
        path, value = left.pop()
        if isinstance(value, list):
            left += [((*path, number), entry) for number, entry in reversed(list(enumerate(value)))]
        if isinstance(value, Mapping):
            yield from _named_in(path, value)
            left += [((*path, key), value[key]) for key in reversed(list(value))]


def _named_in(path: KeyPath, table: Mapping[str, Any]) -> Iterator[_Name]:
    for key in COMPARISONS:
        if isinstance(table.get(key), str):
            yield _Name("target", table[key], (*path, key))
    figure = table.get("figure")
    if isinstance(figure, Mapping) and isinstance(figure.get("name"), str):
        yield _Name("figure", figure["name"], (*path, "figure", "name"))
    for key in ("rule", *KEYS_ABOUT_WHOM):
        if isinstance(table.get(key), str):
            yield _Name("counted" if key in KEYS_OF_GROUPS else key, table[key], (*path, key))
    for key, kind in (("of", "counted" if path[-1] == "count" else "target"), ("rules", "rule")):
        names = table.get(key) if isinstance(table.get(key), list) else ()
        each = ((number, name) for number, name in enumerate(names or ()) if isinstance(name, str))
        yield from (_Name(kind, name, (*path, key, number)) for number, name in each)


def _steps(draft: Draft, section: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    steps = table.get("escalation")
    yield from _exists(table, "notify", draft.names("notifiers"), ("rules", section))
    for number, step in enumerate(steps if isinstance(steps, list) else ()):
        if not isinstance(step, Mapping):
            continue
        at: KeyPath = ("rules", section, "escalation", number)
        yield from _exists(step, "actuator", draft.output_names, at)
        yield from _exists(step, "notify", draft.names("notifiers"), at)
        if "topic" in step and "messenger" not in draft.table:
            message = f"nothing sends '{step['topic']}': there is no section [messenger]"
            yield Finding((*at, "topic"), message, "add one, or notify people with notify", "unknown-name")


def _groups(draft: Draft) -> Iterator[Finding]:
    """Check that no target has a name that several of one kind take."""
    taken = {member: group for group, members in draft.groups.items() for member in members}
    taken |= {each.name: each.name.rpartition("-")[0] for each in draft.nearest}
    for section in ("targets", "sensors"):
        for name in draft.tables(section):
            if name in taken:
                message = f"'{name}' is one of the targets that [targets.{taken[name]}] stands for"
                yield Finding((section, name), message, "give one another name", "name-twice")


def _buttons(draft: Draft) -> Iterator[Finding]:
    """Check what buttons ask of alarms."""
    for button, table in draft.button_tables.items():
        is_for_alarms = not {table.press, table.hold}.isdisjoint(_OF_ALARMS)
        rules = (each.rule for each in draft.compiled)
        alarms = [gate_of(rule) for rule in rules if isinstance(rule, AlarmRule) or not is_for_alarms]
        at: KeyPath = ("buttons", button)
        meant = [rule for rule in alarms if table.rule in {"", rule.name}]
        if not meant and table.rule and (table.rule in draft.rules or table.rule not in draft.names("rules")):
            hint = did_you_mean_or_list(table.rule, [rule.name for rule in alarms])
            yield Finding((*at, "rule"), f"there is no alarm '{table.rule}'", hint, "unknown-name")
        if "shelve" in {table.press, table.hold}:
            yield from _shelved_for(meant, table, at)


def _shelved_for(meant: list[AlarmRule], table: ButtonTable, at: KeyPath) -> Iterator[Finding]:
    """Check that alarms may be shelved for as long as a button asks. Of every alarm, those that never may are left."""
    may_be = [rule for rule in meant if rule.shelve_max_s > 0 or table.rule]
    for rule in sorted(may_be, key=lambda rule: rule.shelve_max_s)[:1]:
        if rule.shelve_max_s <= 0:
            yield Finding((*at, "rule"), f"'{rule.name}' can never be shelved", "name another alarm", "shelve-too-long")
        elif table.shelve_for is not None and table.shelve_for > rule.shelve_max_s:
            message = f"'{rule.name}' may be shelved for {duration(rule.shelve_max_s)} at most (shelve_max)"
            hint = "shorten shelve_for, or raise shelve_max of the rule"
            yield Finding((*at, "shelve_for"), message, hint, "shelve-too-long")


def _exists(step: Mapping[str, Any], key: str, known: Iterable[str], at: KeyPath) -> Iterator[Finding]:
    name = step.get(key)
    if not isinstance(name, str) or name in (names := list(known)):
        return
    kind = "notifier" if key == "notify" else key
    hint = did_you_mean_or_list(name, names) or f"add a section [{kind}s.{name}]"
    yield Finding((*at, key), f"there is no {kind} '{name}'", hint, "unknown-name")


def _cycles(draft: Draft) -> Iterator[Finding]:
    """Find rings of rules, each of which asks whether the next is active. Each rule is reported in one at most."""
    sections = draft.tables("rules")
    asks = {section: {_section_of(name, sections): name for name in _rules_in(section, table)}
            for section, table in sections.items()}  # fmt: skip
    order = list(asks)
    for _ in range(_MAX_RINGS):
        try:
            TopologicalSorter(asks).prepare()
            break
        except CycleError as error:
            # Each of them asks for the one before it, and the last is the first again.
            ring: list[str] = error.args[1][:0:-1]
            start = ring.index(min(ring, key=order.index))
            ring = [*ring[start:], *ring[:start]]
            yield _in_a_ring(ring, asks[ring[0]][ring[1 % len(ring)]].path)
            asks = {section: names for section, names in asks.items() if section not in ring}


def _rules_in(section: str, table: Mapping[str, Any]) -> Iterator[_Name]:
    return (name for name in _names(section, table) if name.kind == "rule")


def _section_of(name: _Name, sections: Mapping[str, Any]) -> str:
    """Return the table that a rule comes from: ``near:ball`` comes from ``near``."""
    return name.name if name.name in sections else name.name.partition(":")[0]


def _in_a_ring(ring: list[str], path: KeyPath) -> Finding:
    if len(ring) == 1:
        does = "suppresses itself" if "suppress_when" in path else "asks whether it is active itself"
        return Finding(path, f"the rule '{ring[0]}' {does}", "name another rule", "reference-cycle")
    names = [f"'{name}'" for name in (*ring, ring[0])]
    if len(names) > _MAX_NAMES:
        names[_MAX_NAMES - 2 : -1] = ["…"]
    message = f"these rules wait for each other: {' → '.join(names)}"
    return Finding(path, message, "take one of them out of the ring", "reference-cycle")
