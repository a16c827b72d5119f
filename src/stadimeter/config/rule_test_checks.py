"""Mistakes in the tests of a configuration: what one table does not say by itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from stadimeter.config.cross_checks import rule_names
from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.driver_tables import validate
from stadimeter.config.files import is_file
from stadimeter.config.findings import Finding, did_you_mean_or_list, format_value
from stadimeter.config.rule_test_tables import (
    OF_ACTUATORS,
    OF_BASES,
    OF_OUTPUTS,
    OF_RULES,
    InputTable,
    RuleTest,
    RuleTestTable,
)
from stadimeter.config.toml_lines import KeyPath, SourceSpan
from stadimeter.config.units import validation_context
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.rule import AlarmRule


def read_tests(draft: Draft, file: Path, spans: Mapping[KeyPath, SourceSpan]) -> None:
    """Add the tests of a configuration to its draft, and what makes them unusable."""
    tables = draft.table["tests"]
    if not isinstance(tables, list):
        message = "'tests' is not a list of tables"
        draft.findings.append(Finding(("tests",), message, "write it as [[tests]]", "bad-value"))
        return
    for position, table in enumerate(tables):
        at: KeyPath = ("tests", position)
        if not isinstance(table, Mapping):
            message = f"{format_value(table)} is not a table"
            draft.findings.append(Finding(at, message, "write it below [[tests]]", "bad-value"))
        elif read := validate(RuleTestTable, table, at, validation_context(file), draft.findings):
            name = read.name or f"test {position + 1}"
            draft.tests[position] = RuleTest(name=name, line=spans[at].line, input=read.input, expect=read.expect)
    draft.findings += _mistakes(draft)


def rule_test_warnings(draft: Draft) -> Iterator[Finding]:
    """Find tests that cannot be run here, though the configuration can."""
    for position, test in draft.tests.items():
        journal = test.input.journal
        if journal is not None and not is_file(journal):
            hint = "record one with `stadimeter run CONFIG --journal FILE`; until then the test fails"
            yield Finding(("tests", position, "input", "journal"), f"there is no recording {journal}", hint)


def _mistakes(draft: Draft) -> Iterator[Finding]:
    names: dict[str, int] = {}
    for position, test in draft.tests.items():
        at: KeyPath = ("tests", position)
        if names.setdefault(test.name, position) != position:
            message = f"two tests are called '{test.name}'"
            yield Finding((*at, "name"), message, "give each a name of its own")
        yield from _input(draft, (*at, "input"), test.input)
        for subject in test.expect:
            yield from _expected(draft, (*at, "expect", subject), test, subject)


def _input(draft: Draft, at: KeyPath, given: InputTable) -> Iterator[Finding]:
    measured, rules = draft.measured_names, tuple(rule_names(draft))
    named = [((*at, "targets", name), "target", name, measured) for name in given.targets or ()]
    named += [((*at, "target"), "target", given.target, measured)] if given.target is not None else []
    for index, table in enumerate(given.operator):
        named += [((*at, "operator", index, "rule"), "rule", table.rule, rules)] if table.rule else []
        if table.at > given.moving_s > 0:
            yield _too_late((*at, "operator", index, "at"), table.at, given.moving_s)
    for path, kind, name, known in named:
        if name not in known:
            yield Finding(path, f"there is no {kind} '{name}'", did_you_mean_or_list(name, known))
    of_camera = draft.names("targets")
    if len(of_camera) > 1 and given.journal is None and given.target is None and given.targets is None:
        message = f"which of the targets {', '.join(of_camera)} moves?"
        yield Finding((*at, "target"), message, f'add target = "{measured[0]}", or targets.NAME for each')


def _expected(draft: Draft, at: KeyPath, test: RuleTest, subject: str) -> Iterator[Finding]:
    rules, outputs, expected = tuple(rule_names(draft)), draft.output_names, test.expect[subject]
    if subject not in (known := [*rules, *outputs]):
        yield Finding(at, f"there is no rule and no output '{subject}'", did_you_mean_or_list(subject, known))
        return
    fitting: list[str] = [*OF_RULES] if subject in rules else []
    if subject in outputs:
        fitting += [*(OF_BASES if subject == BASE_NAME else OF_ACTUATORS), *OF_OUTPUTS]
    for key in sorted(expected.model_fields_set - set(fitting)):
        hint = f"of '{subject}' these can be expected: {', '.join(fitting)}"
        yield Finding((*at, key), f"'{key}' cannot be expected of '{subject}'", hint)
    for key in sorted(expected.model_fields_set & {"raised_within", "cleared_within"}):
        instead = f"write {key.partition('_')[0]}_by with a time from the start of the test"
        if test.input.journal is not None:
            yield Finding((*at, key), "where the target truly was, a recording does not know", instead)
        elif not _is_on_distance(draft, subject):
            message = f"'{subject}' has no limit on the distance alone, so there is no moment at which it is crossed"
            yield Finding((*at, key), message, instead)
    for key, times in expected.moments().items() if test.input.moving_s else ():
        yield from (_too_late((*at, key), at_s, test.input.moving_s) for at_s in times if at_s > test.input.moving_s)


def _is_on_distance(draft: Draft, rule_name: str) -> bool:
    compiled = next((each for each in draft.compiled if rule_name in (each.rule.name, each.section)), None)
    if compiled is None:
        return True  # what could not be read has findings of its own
    condition = compiled.rule.condition if isinstance(compiled.rule, AlarmRule) else None
    return isinstance(condition, DistanceCondition) and condition.quantity == "distance"


def _too_late(at: KeyPath, at_s: float, end_s: float) -> Finding:
    return Finding(at, f"{at_s:g} s is after the end of the test at {end_s:g} s", "let the test last longer")
