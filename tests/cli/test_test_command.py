"""The command ``test`` runs the tests of a configuration and says what failed, when and why."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli.main import app
from support.simulated_run import SIMULATED_BALL

RULES = """
[rules.near]
actuator = "motor"
when = { below = "50 cm" }

[world]
"""
PASSING = """
[[tests]]
name = "hover does not chatter"
input = { hover = { at = "50 cm", for = "10 s" } }
expect.near = { transitions_max = 2 }
"""
FAILING = """
[[tests]]
name = "a ball that stays away is noticed"
input = { hover = { at = "1 m", for = "3 s" } }
expect.near = { raised_by = "2 s" }
"""

Tested = Callable[..., Result]


@pytest.fixture
def tested(tmp_path: Path) -> Tested:
    """Return a function that runs the command on a configuration with the given tests."""

    def of(tests: str, *options: str) -> Result:
        file = tmp_path / "tested.toml"
        file.write_text(SIMULATED_BALL + RULES + tests, encoding="utf-8")
        return CliRunner().invoke(app, ["test", str(file), *options])

    return of


def test_what_passes_is_one_line_each(tested: Tested) -> None:
    result = tested(PASSING)
    assert result.exit_code == 0
    assert result.stdout.splitlines() == ["passed  hover does not chatter  10.0 s, 301 cycles", "1 test: 1 passed"]


def test_what_fails_says_what_was_expected_what_came_and_why(tested: Tested, tmp_path: Path) -> None:
    result = tested(PASSING + FAILING)
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    text = (tmp_path / "tested.toml").read_text(encoding="utf-8")
    line = text[: text.index('[[tests]]\nname = "a ball')].count("\n") + 1
    assert lines[1:6] == [
        "FAILED  a ball that stays away is noticed  3.0 s, 91 cycles",
        f"        {tmp_path / 'tested.toml'}:{line}",
        "        near.raised_by",
        "          expected  raised by 2.00 s",
        "          got       never raised",
    ]
    assert lines[6].startswith("          why       at 2.00 s: not raised: 1.00")
    assert lines[7] == "2 tests: 1 passed, 1 failed"


def test_a_name_that_no_test_has_is_an_error_that_lists_them(tested: Tested) -> None:
    result = tested(PASSING, "--name", "hoover")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "no test whose name holds 'hoover'; there are: 'hover does not chatter'" in result.stderr


def test_a_configuration_without_tests_is_no_failure_and_is_shown_one(tested: Tested) -> None:
    result = tested("")
    assert result.exit_code == 0
    assert "has no tests. One looks like this:" in result.stdout
    assert "[[tests]]" in result.stdout


def test_programs_get_one_object(tested: Tested) -> None:
    result = tested(PASSING + FAILING, "--json")
    assert result.exit_code == 1
    record = json.loads(result.stdout)
    assert (record["passed"], record["failed"]) == (1, 1)
    passing, failing = record["tests"]
    assert passing["passed"]
    assert passing["failures"] == []
    assert passing["events"][0]["kind"] == "target_seen"
    (failure,) = failing["failures"]
    assert failure["subject"] == "near"
    assert failure["key"] == "raised_by"
    assert failure["at_s"] == pytest.approx(2.0)
    assert failure["why"].startswith("not raised: ")


def test_a_test_that_cannot_be_run_fails_and_the_others_go_on(tested: Tested) -> None:
    missing = '\n[[tests]]\ninput = { journal = "run.jsonl" }\nexpect.near = { raised = 1 }\n'
    result = tested(missing + PASSING)
    assert result.exit_code == 1
    assert "FAILED  test 1" in result.stdout
    assert "it could not be run: " in result.stdout
    assert "run.jsonl: there is no such file" in result.stdout
    assert "2 tests: 1 passed, 1 failed" in result.stdout
