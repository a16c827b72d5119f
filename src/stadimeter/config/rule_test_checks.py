"""Mistakes in the tests of a configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.driver_tables import validate
from stadimeter.config.files import is_file
from stadimeter.config.findings import Finding, did_you_mean, did_you_mean_or_list, format_value
from stadimeter.config.rule_test_tables import (
    FRAMES_MAX,
    MOTIONS,
    OF_ACTUATORS,
    OF_BASES,
    OF_OUTPUTS,
    OF_RULES,
    ExpectTable,
    InputTable,
    MotionTable,
    RuleTest,
    RuleTestTable,
)
from stadimeter.config.toml_lines import KeyPath, SourceSpan
from stadimeter.config.units import validation_context
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.rule import AlarmRule

# Keys of which a recording has its own.
_MADE_UP = (*MOTIONS, "targets", "target", "bearing", "elevation", "lost", "noise", "dropouts", "outliers", "rate")
_MADE_UP_TOO = ("repeat", "seed", "frozen", "clock", "day", "date", "operator")
_MAX_RATE_HZ = 30.0
_EXAMPLE = "expect.RULE = { raised = 1 }"


def read_tests(draft: Draft, file: Path, spans: Mapping[KeyPath, SourceSpan]) -> None:
    """Add the tests of a configuration to its draft, and what makes them unusable."""
    tables = draft.table["tests"]
    if not isinstance(tables, list):
        draft.findings.append(
            Finding(("tests",), "'tests' is not a list of tables", "write it as [[tests]]", "bad-value")
        )
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


def _mistakes(draft: Draft) -> Iterator[Finding]:
    names: dict[str, int] = {}
    for position, test in draft.tests.items():
        if names.setdefault(test.name, position) != position:
            message = f"two tests are called '{test.name}'"
            yield Finding(("tests", position, "name"), message, "give each a name of its own")
        yield from _input(draft, ("tests", position, "input"), test.input, _written(draft, position, "input"))
        if not _written(draft, position, "expect"):
            yield Finding(("tests", position, "expect"), "the test expects nothing", f"add {_EXAMPLE}")
        for subject, expected in test.expect.items():
            at = ("tests", position, "expect", subject)
            yield from _subject(draft, at, subject, expected)
            yield from _within(draft, at, subject, test.input)
            yield from _times(at, expected, test.input)
            yield from _contradictions(at, expected)


def rule_test_warnings(draft: Draft) -> Iterator[Finding]:
    """Find tests that cannot be run here, though the configuration can."""
    for position, test in draft.tests.items():
        journal = test.input.journal
        if journal is not None and not is_file(journal):
            hint = "record one with `stadimeter run CONFIG --journal FILE`; until then the test fails"
            yield Finding(("tests", position, "input", "journal"), f"there is no recording {journal}", hint)


def _written(draft: Draft, position: int, key: str) -> Mapping[str, Any]:
    table = draft.table["tests"][position].get(key, {})
    return table if isinstance(table, Mapping) else {}


def _input(draft: Draft, at: KeyPath, given: InputTable, written: Mapping[str, Any]) -> Iterator[Finding]:
    if "journal" in written:
        for key in (*_MADE_UP, *_MADE_UP_TOO):
            if key in written:
                message = f"a recording has its own '{key}'"
                yield Finding((*at, key), message, "take it out, or the journal")
        return
    yield from _targets(draft, at, given, written)
    yield from _motion(at, given, written, is_needed="targets" not in written)
    for name, motion in (given.targets or {}).items():
        yield from _motion((*at, "targets", name), motion, written["targets"][name], is_needed=True)
    if given.date is not None and given.clock is None:
        yield Finding((*at, "date"), "a date without a time of day", 'add one, such as clock = "12:00"')
    if given.date is not None and "day" in written:
        yield Finding((*at, "day"), f"{given.date} has a day of the week of its own", "leave it out")
    yield from _length(at, given)
    yield from _orders(draft, at, given)


def _targets(draft: Draft, at: KeyPath, given: InputTable, written: Mapping[str, Any]) -> Iterator[Finding]:
    known, of_camera = draft.measured_names, draft.names("targets")
    named = {(*at, "targets", name): name for name in given.targets or ()}
    if given.target is not None:
        named[*at, "target"] = given.target
    for path, name in named.items():
        if name not in known:
            yield Finding(path, f"there is no target '{name}'", did_you_mean_or_list(name, known))
    if len(of_camera) > 1 and not {"target", "targets"} & written.keys():
        message = f"which of the targets {', '.join(of_camera)} moves?"
        yield Finding((*at, "target"), message, f'add target = "{known[0]}", or targets = {{ {known[0]} = {{ … }} }}')
    if "targets" in written:
        yield from _nothing_beside_targets(at, written)


def _nothing_beside_targets(at: KeyPath, written: Mapping[str, Any]) -> Iterator[Finding]:
    if not written["targets"]:
        yield Finding((*at, "targets"), "no target moves", "add one, such as targets.NAME = { … }")
    for key in ("target", *MOTIONS, "lost", "bearing", "elevation", "repeat"):
        if key in written:
            yield Finding((*at, key), f"'{key}' does not go with 'targets'", "put it inside one of them, or out")


def _motion(at: KeyPath, motion: MotionTable, written: Mapping[str, Any], *, is_needed: bool) -> Iterator[Finding]:
    given = [key for key in MOTIONS if key in written]
    is_misspelt = any(did_you_mean(key, MOTIONS) for key in written if key not in InputTable.model_fields)
    if is_needed and not given and not is_misspelt:
        hint = 'add one, such as hover = { at = "50 cm", for = "60 s" }'
        yield Finding(at, f"the test does not say what happens; known are: {', '.join(MOTIONS)}, journal", hint)
    for extra in given[1:]:
        yield Finding((*at, extra), f"a target cannot {given[0]} and {extra} at once", "use points for both")
    yield from _directions(at, motion)
    yield from _points(at, motion)


def _directions(at: KeyPath, motion: MotionTable) -> Iterator[Finding]:
    for key, is_nearer in (("approach", True), ("recede", False)):
        travel = getattr(motion, key)
        if travel is not None and (travel.end < travel.start) is not is_nearer:
            wanted, other = ("nearer", "recede") if is_nearer else ("further", "approach")
            message = f"from {travel.start:g} m to {travel.end:g} m is not {wanted}"
            yield Finding((*at, key), message, f"swap the two, or write {other}")


def _points(at: KeyPath, motion: MotionTable) -> Iterator[Finding]:
    if not motion.points:
        return
    if motion.points[0].at != 0:
        message = f"the points begin at {motion.points[0].at:g} s; the first must be at '0 s'"
        yield Finding((*at, "points", 0, "at"), message)
    for index, (before, after) in enumerate(pairwise(motion.points), start=1):
        if after.at < before.at:
            message = f"the point at {after.at:g} s follows one at {before.at:g} s; order them by time"
            yield Finding((*at, "points", index, "at"), message)


def _length(at: KeyPath, given: InputTable) -> Iterator[Finding]:
    if given.moving_s * (given.rate or _MAX_RATE_HZ) > FRAMES_MAX:
        message = f"{given.moving_s:g} s are more than {FRAMES_MAX:,} frames, the most that a test may have"
        yield Finding(at, message, "make it shorter")
    if given.moving_s == 0 and given.points and len(given.points) == 1:
        yield Finding((*at, "points"), "a single point takes no time", "add where the target is later, or use hover")


def _orders(draft: Draft, at: KeyPath, given: InputTable) -> Iterator[Finding]:
    rules = _rules(draft)
    for index, table in enumerate(given.operator):
        here = (*at, "operator", index)
        orders = table.orders()
        if len(orders) != 1:
            message = "one entry tells one rule one thing" if orders else "the entry does not say what is done"
            yield Finding(here, message, 'write it such as { at = "3 s", acknowledge = "near" }')
        for action, rule in orders:
            if rule not in rules and not action.is_on_outputs:
                path = (*here, action.replace("-", "_"))
                yield Finding(path, f"there is no rule '{rule}'", did_you_mean_or_list(rule, rules))
        if table.at > given.moving_s > 0:
            yield _too_late((*here, "at"), table.at, given.moving_s)


def _rules(draft: Draft) -> tuple[str, ...]:
    """Return the names of all alarms, ramps and follow rules; a table with several targets stands for several."""
    names: list[str] = []
    for name, table in draft.tables("rules").items():
        targets = table.get("targets")
        if not isinstance(targets, list):
            names.append(name)
            continue
        each = draft.expanded(target for target in targets if isinstance(target, str))
        names += [f"{name}:{target}" for target in each]
    return tuple(names)


def _subject(draft: Draft, at: KeyPath, subject: str, expected: ExpectTable) -> Iterator[Finding]:
    rules, outputs = _rules(draft), draft.output_names
    known = [*rules, *outputs]
    if subject not in known:
        hint = did_you_mean_or_list(subject, known)
        yield Finding(at, f"there is no rule and no output '{subject}'", hint)
        return
    fitting: list[str] = [*OF_RULES] if subject in rules else []
    if subject in outputs:
        fitting += [*(OF_BASES if subject == BASE_NAME else OF_ACTUATORS), *OF_OUTPUTS]
    if not _written(draft, int(at[1]), "expect").get(subject):
        yield Finding(at, f"nothing is expected of '{subject}'", f"known are: {', '.join(fitting)}")
    for key in sorted(expected.model_fields_set - set(fitting)):
        hint = f"of '{subject}' these can be expected: {', '.join(fitting)}"
        yield Finding((*at, key), f"'{key}' cannot be expected of '{subject}'", hint)


def _within(draft: Draft, at: KeyPath, subject: str, given: InputTable) -> Iterator[Finding]:
    test = draft.tests[int(at[1])]
    for key in ("raised_within", "cleared_within"):
        if getattr(test.expect[subject], key) is None:
            continue
        instead = f"write {key.partition('_')[0]}_by with a time from the start of the test"
        if given.journal is not None:
            yield Finding((*at, key), "where the target truly was, a recording does not know", instead)
        elif not _is_on_distance(draft, subject):
            message = f"'{subject}' has no limit on the distance alone, so there is no moment at which it is crossed"
            yield Finding((*at, key), message, instead)


def _is_on_distance(draft: Draft, rule_name: str) -> bool:
    compiled = next((each for each in draft.compiled if rule_name in (each.rule.name, each.section)), None)
    if compiled is None:
        return True  # what could not be read has findings of its own
    condition = compiled.rule.condition if isinstance(compiled.rule, AlarmRule) else None
    return isinstance(condition, DistanceCondition) and condition.quantity == "distance"


def _times(at: KeyPath, expected: ExpectTable, given: InputTable) -> Iterator[Finding]:
    if given.moving_s == 0:
        return
    for key, times in expected.moments().items():
        for at_s in times:
            if at_s > given.moving_s:
                yield _too_late((*at, key), at_s, given.moving_s)


def _too_late(at: Sequence[str | int], at_s: float, end_s: float) -> Finding:
    return Finding(tuple(at), f"{at_s:g} s is after the end of the test at {end_s:g} s", "let the test last longer")


def _contradictions(at: KeyPath, expected: ExpectTable) -> Iterator[Finding]:
    for kind in ("raised", "cleared"):
        by_s, after_s = getattr(expected, f"{kind}_by"), getattr(expected, f"{kind}_after")
        if by_s is not None and after_s is not None and by_s < after_s:
            yield Finding((*at, f"{kind}_by"), f"nothing is {kind} by {by_s:g} s and not before {after_s:g} s")
        times = [key for key in (f"{kind}_by", f"{kind}_after", f"{kind}_within") if getattr(expected, key) is not None]
        if getattr(expected, kind) == 0 and times:
            yield Finding((*at, times[0]), f"'{kind} = 0' expects that it never happens, and this says when")
