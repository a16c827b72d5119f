"""Rules compiled from their tables: what the core runs, each beside its table in the file. This is done once.

The loader, the analysis, the descriptions and the checks of rule tests share the result, so that a finding about what
the core runs names the line and the words that it came from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.config.rules.conditions import KEYS_OF_GROUPS, FigureTable, OfEach, kinds_in
from stadimeter.config.rules.tables import KINDS, RuleTable
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not, about, leaves, targets_of, with_leaves
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.rule import ALWAYS, AlarmRule, AnyRule, gate_of

# The keys that stand for several rules or targets, by what their conditions are parts of.
_SEVERAL = {AnyOf: {"rule", "any_of"}, AllOf: {"all_of"}}


class WrittenCondition(Struct, frozen=True, kw_only=True):
    """A condition and its table in the file."""

    path: KeyPath
    table: Mapping[str, Any]
    """The table as it was written; empty if it is not known."""
    condition: Condition

    def parts(self) -> tuple[WrittenCondition, ...]:
        """Return the conditions that it is made of; none for a simple one."""
        match self.condition:
            case AnyOf() | AllOf() as whole if self.table.keys() & _SEVERAL[type(whole)]:
                table = {key: value for key, value in self.table.items() if key not in KEYS_OF_GROUPS}
                return tuple(replace(self, table=table, condition=member) for member in whole.conditions)
            case AllOf(conditions=conditions) if len(kinds := kinds_in(self.table)) > 1:  # short for all of them
                each = zip(kinds, conditions, strict=True)
                return tuple(replace(self, table=table, condition=condition) for table, condition in each)
            case AllOf(conditions=conditions):
                return self._parts("all", conditions)
            case AnyOf(conditions=conditions):
                return self._parts("any", conditions)
            case Not(condition=condition):
                return (_at((*self.path, "not"), self.table.get("not"), condition),)
            case _:
                return ()

    def leaves(self) -> Iterator[WrittenCondition]:
        """Go through the simple conditions that it is made of, from left to right."""
        parts = self.parts()
        if not parts:
            yield self
        for part in parts:
            yield from part.leaves()

    @property
    def limits_path(self) -> KeyPath:
        """The place of its limits: its own table, or the one inside it that names the quantity."""
        inner = next((key for key, value in self.table.items() if isinstance(value, Mapping) and key != "not"), None)
        return self.path if inner is None else (*self.path, inner)

    def _parts(self, key: str, conditions: tuple[Condition, ...]) -> tuple[WrittenCondition, ...]:
        tables = self.table.get(key)
        entries: list[Any] = tables if isinstance(tables, list) and len(tables) == len(conditions) else []
        known = entries or [None] * len(conditions)
        return tuple(
            _at((*self.path, key, number), table, condition)
            for number, (table, condition) in enumerate(zip(known, conditions, strict=True))
        )


class CompiledRule(Struct, frozen=True, kw_only=True):
    """A rule as the core runs it, and the table that it was compiled from."""

    section: str
    """The name of the table; several rules come from one that names several targets."""
    table: Mapping[str, Any]
    """The table as it was written."""
    rule: AnyRule
    needs_target: bool
    """Whether a part of it names no target, and so is about the rule's own."""

    @property
    def path(self) -> KeyPath:
        """The place of the table."""
        return ("rules", self.section)

    def at(self, *keys: str | int) -> KeyPath:
        """Return where a key of the table stands, or would stand."""
        return (*self.path, *keys)

    def conditions(self) -> Iterator[WrittenCondition]:
        """Go through ``when`` and ``suppress_when``, and those of its steps, as far as it has them."""
        alarm = gate_of(self.rule)
        if alarm.condition is not ALWAYS:
            yield _at(self.at("when"), self.table.get("when"), alarm.condition)
        if alarm.suppress_when is not None:
            yield _at(self.at("suppress_when"), self.table.get("suppress_when"), alarm.suppress_when)
        for number, step in enumerate(alarm.escalation):
            if step.when is not None:
                table = self.table["escalation"][number].get("when")
                yield _at(self.at("escalation", number, "when"), table, step.when)


def compile_rules(
    tables: Mapping[str, RuleTable],
    written: Mapping[str, Mapping[str, Any]],
    targets: Sequence[str],
    names: SeveralNames,
) -> tuple[CompiledRule, ...]:
    """Compile rules, in the order of the file.

    Args:
        tables: The rules that could be read, by name. Those of no kind are left out: they have a finding of their own.
        names: What names of groups and of figures stand for.
    """
    names = names._replace(rules={name: each.names(name) for name, each in tables.items() if each.targets is not None})
    compiled = [
        _naming_members(rule, names)
        for section, table in tables.items()
        if any(getattr(table, kind) is not None for kind in KINDS)
        for rule in _compiled(section, table, written[section], targets)
    ]
    counted = {
        name
        for each in compiled
        for written_condition in each.conditions()
        for leaf in leaves(written_condition.condition)
        if isinstance(leaf, RememberedCondition) and leaf.unit == "times"
        for name in leaf.rules
    }
    return tuple(_without_limit(each) if each.rule.name in counted else each for each in compiled)


def _without_limit(compiled: CompiledRule) -> CompiledRule:
    """Return a rule that is counted without the limit on chattering, which would hide raises, unless it was written."""
    rule = compiled.rule
    if isinstance(rule, AlarmRule) and "raises_per_min_max" not in compiled.table:
        return replace(compiled, rule=replace(rule, raises_per_min_max=0))
    return compiled


def _compiled(
    section: str, table: RuleTable, written: Mapping[str, Any], targets: Sequence[str]
) -> Iterator[CompiledRule]:
    conditions = table.conditions()
    steps = (step.when.to_plan(table.severity) for step in table.steps if step.when is not None)
    all_of_it = (*(each for each in conditions if each is not None), *steps)
    needs_target = table.is_gated or any("" in targets_of(each) for each in all_of_it)
    for rule in table.to_plans(section, targets, conditions):
        yield CompiledRule(section=section, table=written, rule=rule, needs_target=needs_target)


class SeveralNames(NamedTuple):
    """The things that names in conditions stand for."""

    groups: Mapping[str, tuple[str, ...]]
    """The members of each group of targets."""
    measured: Sequence[str]
    """What is counted where a count names no target."""
    figures: Mapping[str, FigureTable]
    """The remembered figures."""
    rules: Mapping[str, tuple[str, ...]] = {}
    """The rules of each table of several."""


def _naming_members(compiled: CompiledRule, names: SeveralNames) -> CompiledRule:
    """Let conditions that ask for a table of several rules ask for its rules: it is active when one of them is.

    Those on a figure note its quantity, counts of a group count its members, and one on any or all of a group is made
    of one on each.
    """
    rule, alarm = compiled.rule, gate_of(compiled.rule)

    def named(condition: Condition | None) -> Condition | None:
        return None if condition is None else _members_in(condition, names)

    after = replace(
        alarm,
        condition=alarm.condition if alarm.condition is ALWAYS else named(alarm.condition),
        suppress_when=named(alarm.suppress_when),
        escalation=tuple(replace(step, when=named(step.when)) for step in alarm.escalation),
    )
    return replace(compiled, rule=after if isinstance(rule, AlarmRule) else replace(rule, gate=after))


def _members_in(condition: Condition, names: SeveralNames) -> Condition:
    def named(leaf: Leaf) -> Condition:
        match leaf:
            case RememberedCondition() if leaf.name in names.figures:
                return replace(leaf, quantity=names.figures[leaf.name].of)
            case RememberedCondition():
                return replace(leaf, rules=tuple(one for rule in leaf.rules for one in names.rules.get(rule, (rule,))))
            case OfEach():
                members = names.groups.get(leaf.group, (leaf.group,))
                return leaf.whole(conditions=tuple(_members_in(about(leaf.condition, each), names) for each in members))
            case RuleCondition() if leaf.rule in names.rules:
                return AnyOf(conditions=tuple(RuleCondition(rule=name) for name in names.rules[leaf.rule]))
            case CountCondition() if names.groups:
                targets = leaf.targets or names.measured
                return replace(leaf, targets=tuple(one for each in targets for one in names.groups.get(each, (each,))))
            case _:
                return leaf

    return with_leaves(condition, map(named, leaves(condition)))


def _at(path: KeyPath, table: object, condition: Condition) -> WrittenCondition:
    return WrittenCondition(path=path, table=table if isinstance(table, Mapping) else {}, condition=condition)
