"""Every class of mistake that `check` finds: a file that has it, and one beside it that has not.

A line that is wrong says so itself in its comment: ``# error CODE: MESSAGE`` or ``# warning CODE: MESSAGE``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError, Problem

FOLDER = Path(__file__).parent / "analysis"
BAD = sorted(FOLDER.glob("*.bad.toml"))
GOOD = sorted(FOLDER.glob("*.good.toml"))
SAID = re.compile(r"# (error|warning) ([a-z-]+): (.+)$")

CLASSES = {
    "bad-value", "driver", "equal-priority", "feet-cut", "height-unknown", "model-missing", "motion-blind",
    "never-true", "output-unused", "pin-taken", "reference-cycle", "shadowed", "unheard", "unknown-key", "unknown-name",
    "unreachable", "unresolvable",
}  # fmt: skip
"""The codes that programs may rely on."""

SAY_THEMSELVES = {"bad-value", "driver"}
"""The codes of problems that may come without a hint."""

Load = Callable[[str], Configuration]
Problems = Callable[[str], tuple[Problem, ...]]
Said = tuple[int, str, str, str]


def found(file: Path) -> Iterator[tuple[str, Problem]]:
    try:
        configuration = load_configuration(file)
    except ConfigError as error:
        yield from (("error", problem) for problem in error.problems)
    else:
        warnings = (*configuration.warnings, *feasibility_warnings(configuration))
        yield from (("warning", problem) for problem in warnings)


def said_in(file: Path) -> list[Said]:
    lines = enumerate(file.read_text(encoding="utf-8").splitlines(), start=1)
    return [(number, *said.groups()) for number, line in lines if (said := SAID.search(line))]


def test_each_mistake_is_told_at_its_line_with_what_to_do_and_nothing_else_is(subtests: pytest.Subtests) -> None:
    for file in BAD:
        with subtests.test(file=file.name):
            problems = list(found(file))
            told = [(problem.line, kind, problem.code, problem.message) for kind, problem in problems]
            assert sorted(told) == said_in(file)
            assert told
            assert [problem for _, problem in problems if not (problem.hint or problem.code in SAY_THEMSELVES)] == []


def test_what_looks_alike_and_is_right_is_not_told() -> None:
    told = {file.name: [str(problem) for _, problem in found(file)] for file in GOOD}
    assert {name: problems for name, problems in told.items() if problems} == {}


def test_each_class_has_a_file_that_fails_and_one_that_passes() -> None:
    assert {code for file in BAD for _, _, code, _ in said_in(file)} == CLASSES
    assert [file.name.replace(".bad.", ".good.") for file in BAD] == [file.name for file in GOOD]


def test_a_table_for_several_targets_is_no_rival_of_itself(load: Load, sound: str) -> None:
    second = '[targets.sheet]\ndetector = "sheet"\nwidth = "21 cm"\nheight = "29.7 cm"\n'
    rules = '[rules.near]\ntargets = ["ball", "sheet"]\nactuator = "buzzer"\nwhen = { below = "1 m" }\n'
    warned = {warning.code for warning in load(f"{sound}{second}{rules}").warnings}
    assert warned == {"output-unused"}


def test_a_broken_rule_hides_no_errors_of_the_others(load: Load, sound: str) -> None:
    text = (
        f'{sound}[rules.broken]\nactuator = "motor"\nwhen = {{ belwo = "1 m" }}\n'
        '[rules.lost]\nactuator = "buzer"\nwhen = { lost = true }\n'
    )
    with pytest.raises(ConfigError) as caught:
        load(text)
    assert [problem.code for problem in caught.value.problems] == ["unknown-key", "unknown-name"]


def test_a_rule_that_is_only_tried_out_is_nobodys_rival(load: Load, sound: str) -> None:
    rules = (
        '[rules.near]\nactuator = "buzzer"\nwhen = { below = "1 m" }\n'
        '[rules.new]\nobserve = true\nactuator = "buzzer"\nwhen = { below = "2 m" }\n'
    )
    assert {warning.code for warning in load(sound + rules).warnings} == {"output-unused"}


def test_a_condition_nested_five_hundred_deep_is_one_clear_error(problems_of: Problems, sound: str) -> None:
    when = "{ not = " * 500 + '{ below = "1 m" }' + " }" * 500
    codes = {problem.code for problem in problems_of(f"{sound}[rules.deep]\nwhen = {when}\n")}
    assert codes == {"too-deep"}
