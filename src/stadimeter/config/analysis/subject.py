"""What is looked at: the rules as the core sees them, each beside its table in the file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from stadimeter.config.analysis.logic import Logic
from stadimeter.config.analysis.written import WrittenCondition
from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.rule import AlarmRule, AnyRule


@dataclass(frozen=True, slots=True, kw_only=True)
class DeclaredRule:
    """A rule and its table in the file.

    Attributes:
        section: The name of the table; several rules come from one that names several targets.
        table: The table as it was written.
        rule: What the core makes of it.
    """

    section: str
    table: Mapping[str, Any]
    rule: AnyRule

    @property
    def path(self) -> KeyPath:
        """Where the table stands."""
        return ("rules", self.section)

    def at(self, *keys: str | int) -> KeyPath:
        """Return where a key of the table stands, or would stand.

        Args:
            keys: The key, and those inside it.

        Returns:
            The path.
        """
        return (*self.path, *keys)

    def conditions(self) -> Iterator[WrittenCondition]:
        """Go through what the rule acts on and what suppresses it, if it is an alarm.

        Yields:
            The condition ``when``, and ``suppress_when`` if there is one.
        """
        if isinstance(self.rule, AlarmRule):
            yield self._written("when", self.rule.condition)
            if self.rule.suppress_when is not None:
                yield self._written("suppress_when", self.rule.suppress_when)

    def _written(self, key: str, condition: Any) -> WrittenCondition:
        table = self.table.get(key)
        return WrittenCondition(
            path=self.at(key), table=table if isinstance(table, Mapping) else {}, condition=condition
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """Everything that an analysis needs.

    Attributes:
        draft: The configuration as far as it could be read.
        rules: Its rules, in the order of the file; one of each table that names several targets.
        every_rule: The same with every rule of such tables.
        logic: Which conditions can hold together.
    """

    draft: Draft
    rules: tuple[DeclaredRule, ...]
    every_rule: tuple[DeclaredRule, ...]
    logic: Logic

    @property
    def alarms(self) -> Iterator[tuple[DeclaredRule, AlarmRule]]:
        """Every alarm; one of each table that names several targets."""
        return ((each, each.rule) for each in self.rules if isinstance(each.rule, AlarmRule))

    def combination(self, output: str) -> str | None:
        """Return how an output combines what several rules of one priority ask of it.

        Args:
            output: Its name.

        Returns:
            Such as ``max``, or None if it does not.
        """
        tables = self.draft.tables("actuators")
        base = self.draft.table.get(BASE_NAME)
        if output == BASE_NAME and isinstance(base, Mapping):
            tables[BASE_NAME] = base
        combine = tables.get(output, {}).get("combine")
        return combine if isinstance(combine, str) else None


def subject_of(draft: Draft) -> Subject:
    """Return what of a configuration can be looked at.

    Args:
        draft: The configuration as far as it could be read.

    Returns:
        The subject; without rules that cannot be read at all.
    """
    every_rule = tuple(_declared(draft))
    first = {each.section: each for each in reversed(every_rule)}
    return Subject(
        draft=draft,
        rules=tuple(each for each in every_rule if first[each.section] is each),
        every_rule=every_rule,
        logic=Logic(targets=draft.names("targets")),
    )


def _declared(draft: Draft) -> Iterator[DeclaredRule]:
    tables = draft.tables("rules")
    first_target = next(iter(draft.names("targets")), "")
    for section, rule_table in draft.rules.items():
        try:
            rules = rule_table.to_plans(section, first_target)
        except ValueError:  # it is of no kind, which is said elsewhere
            continue
        yield from (DeclaredRule(section=section, table=tables[section], rule=rule) for rule in rules)
