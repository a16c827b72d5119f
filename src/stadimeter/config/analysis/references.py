"""Names of other rules, targets, actuators and notifiers that must exist, and no rule that waits for itself.

Read from the tables as they were written, so that a rule with a mistake elsewhere is checked too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.findings import Finding, did_you_mean_or_list
from stadimeter.config.models import ButtonTable
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.rule import AlarmRule
from stadimeter.core.words import duration

# A longer ring is written with a gap.
_MAX_NAMES = 8
_CONDITIONS = ("when", "suppress_when")


@dataclass(frozen=True, slots=True)
class _Name:
    """A name that stands in a condition."""

    kind: str
    name: str
    path: KeyPath


def reference_errors(draft: Draft) -> Iterator[Finding]:
    """Find names that stand for nothing, and rules that wait for themselves."""
    rules, targets = set(_rule_names(draft)), draft.names("targets")
    known = {"rule": rules, "target": set(targets)}
    for section, table in draft.tables("rules").items():
        for name in _names(section, table):
            if name.name not in known[name.kind]:
                message = f"there is no {name.kind} '{name.name}'"
                yield Finding(name.path, message, did_you_mean_or_list(name.name, known[name.kind]), "unknown-name")
        yield from _steps(draft, section, table)
    yield from _buttons(draft)
    yield from _cycles(draft)


def rules_asked_for(draft: Draft) -> frozenset[str]:
    """Return the rules that conditions of others ask for."""
    sections = draft.tables("rules")
    return frozenset(
        _in_section(name, sections).name
        for section, table in sections.items()
        for name in _rules_in(section, table)
        if name.name != section
    )


def _rule_names(draft: Draft) -> Iterator[str]:
    for section, table in draft.tables("rules").items():
        yield section
        targets = table.get("targets")
        if isinstance(targets, list):
            yield from (f"{section}:{target}" for target in targets)


def _names(section: str, table: Mapping[str, Any]) -> Iterator[_Name]:
    """Go through the names in the conditions of a rule, however deep these are nested."""
    left: list[tuple[KeyPath, Any]] = [(("rules", section, key), table.get(key)) for key in reversed(_CONDITIONS)]
    while left:
        path, value = left.pop()
        if isinstance(value, list):
            left += [((*path, number), entry) for number, entry in reversed(list(enumerate(value)))]
        if isinstance(value, Mapping):
            yield from _named_in(path, value)
            left += [((*path, key), value[key]) for key in reversed(list(value))]


def _named_in(path: KeyPath, table: Mapping[str, Any]) -> Iterator[_Name]:
    for key in ("rule", "target"):
        if isinstance(table.get(key), str):
            yield _Name(key, table[key], (*path, key))
    if isinstance(table.get("of"), list):
        names = ((number, name) for number, name in enumerate(table["of"]) if isinstance(name, str))
        yield from (_Name("target", name, (*path, "of", number)) for number, name in names)


def _steps(draft: Draft, section: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    steps = table.get("escalation")
    yield from _exists(table, "notify", draft.names("notifiers"), ("rules", section))
    for number, step in enumerate(steps if isinstance(steps, list) else ()):
        if not isinstance(step, Mapping):
            continue
        at: KeyPath = ("rules", section, "escalation", number)
        outputs = [*draft.names("actuators"), *([BASE_NAME] if BASE_NAME in draft.table else [])]
        yield from _exists(step, "actuator", outputs, at)
        yield from _exists(step, "notify", draft.names("notifiers"), at)
        if "topic" in step and "messenger" not in draft.table:
            message = f"nothing sends '{step['topic']}': there is no section [messenger]"
            yield Finding((*at, "topic"), message, "add one, or notify people with notify", "unknown-name")


def _buttons(draft: Draft) -> Iterator[Finding]:
    """Check what buttons ask of alarms."""
    alarms = [each.rule for each in draft.compiled if isinstance(each.rule, AlarmRule)]
    for button, table in draft.button_tables.items():
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
    asks = {section: [_in_section(name, sections) for name in _rules_in(section, table)]
            for section, table in sections.items()}  # fmt: skip
    reported: set[str] = set()
    for section in _without_the_free(asks):
        ring = None if section in reported else _ring(section, asks)
        if ring is not None:
            reported.update(name.name for name in ring)
            yield _in_a_ring(section, ring)


def _without_the_free(asks: Mapping[str, list[_Name]]) -> list[str]:
    """Leave out, one after the other, rules that ask for none of those that are left: they are in no ring."""
    asked_by: dict[str, list[str]] = {section: [] for section in asks}
    for section, names in asks.items():
        for name in names:
            asked_by.setdefault(name.name, []).append(section)
    waits_for = {section: len(names) for section, names in asks.items()}
    free = deque(name for name in asked_by if not waits_for.get(name))
    while free:
        for section in asked_by[free.popleft()]:
            waits_for[section] -= 1
            if not waits_for[section]:
                free.append(section)
    return [section for section, count in waits_for.items() if count]


def _rules_in(section: str, table: Mapping[str, Any]) -> Iterator[_Name]:
    return (name for name in _names(section, table) if name.kind == "rule")


def _in_section(name: _Name, sections: Mapping[str, Any]) -> _Name:
    """Return the table that a rule comes from: ``near:ball`` comes from ``near``."""
    return name if name.name in sections else _Name(name.kind, name.name.partition(":")[0], name.path)


def _ring(start: str, asks: Mapping[str, list[_Name]]) -> list[_Name] | None:
    """Return the shortest way from a rule back to it; None if there is none."""
    came_by: dict[str, _Name] = {}
    came_from: dict[str, str] = {}
    reached = deque([start])
    while reached and start not in came_by:
        section = reached.popleft()
        for name in asks.get(section, ()):
            if name.name not in came_by:
                came_by[name.name], came_from[name.name] = name, section
                reached.append(name.name)
    return _way_back(start, came_by, came_from) if start in came_by else None


def _way_back(start: str, came_by: Mapping[str, _Name], came_from: Mapping[str, str]) -> list[_Name]:
    way = [came_by[start]]
    section = came_from[start]
    while section != start:
        way.insert(0, came_by[section])
        section = came_from[section]
    return way


def _in_a_ring(start: str, ring: list[_Name]) -> Finding:
    suppresses = "suppress_when" in ring[0].path
    if len(ring) == 1:
        message = f"the rule '{start}' {'suppresses itself' if suppresses else 'asks whether it is active itself'}"
        return Finding(ring[0].path, message, "name another rule", "reference-cycle")
    names = [f"'{start}'", *(f"'{name.name}'" for name in ring)]
    if len(names) > _MAX_NAMES:
        names[_MAX_NAMES - 2 : -1] = ["…"]
    message = f"these rules wait for each other: {' → '.join(names)}"
    return Finding(ring[0].path, message, "take one of them out of the ring", "reference-cycle")
