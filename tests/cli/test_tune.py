"""The commands ``tune`` and ``test``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli.main import app
from support.false_alarm import BY_S, CONFIGURATION, STAYED_S, record
from support.noisy_journal import write_noisy_journal
from support.simulated_run import SIMULATED_BALL

# The command ``tune``: marks, settings of one's own, and recordings alone.


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("tune")
    record(found, 1_700_000_000.0)
    return found


@pytest.fixture
def invoked(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(folder)
    Path("stadimeter.toml").write_text(CONFIGURATION)

    def invoke(*arguments: object) -> Result:
        return CliRunner().invoke(app, ["tune", *map(str, arguments), "--config", "stadimeter.toml"])

    return invoke


RUN = "recordings/evening.mcap"
MARKS = ("--mark", f"{RUN}@{BY_S}s no", "--mark", f"{RUN}@{STAYED_S}s fire")


@pytest.mark.long
def test_another_threshold_is_tried_and_nothing_is_changed(invoked):
    done = invoked("near", RUN, "--set", 'below="80 cm"')
    assert done.exit_code == 0, done.output
    assert "below 80 cm (was" in done.output
    assert "near would have fired 2 times in 4 minutes of 1 recording: 0 of them new, 2 of yours gone." in done.output
    assert Path("stadimeter.toml").read_text() == CONFIGURATION


@pytest.mark.long
def test_one_of_the_few_that_meet_marks_is_saved_with_a_test_that_passes(invoked):
    done = invoked("near", *MARKS, "--save", "1")
    assert done.exit_code == 0, done.output
    assert "with 1 test" in done.output
    assert CliRunner().invoke(app, ["test", "stadimeter.toml"]).exit_code == 0


@pytest.mark.long
def test_without_marks_delays_and_deadband_are_found_that_end_false_alarms(invoked, tmp_path):

    def flutter(at_s: float) -> float:
        """Return where a target is that comes by for a moment every ten seconds, and once to stay."""
        return 0.8 if 40 < at_s < 50 or at_s % 10 < 0.3 else 1.2

    fluttering = write_noisy_journal(tmp_path / "fluttering.jsonl", flutter)
    as_it_is, *others = figures(invoked("near", fluttering))
    assert as_it_is["false"] >= 5
    assert others[0] == {"alarms": 1, "false": 0}, "the visit alone"
    nothing = invoked("near", RUN)
    assert nothing.exit_code == 1
    assert "Nothing that was tried is better" in nothing.output


def figures(done: Result) -> list[dict[str, int]]:
    """Return the counts of each numbered row of the table, and of the rule as it is."""
    assert done.exit_code == 0, done.output
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in done.output.splitlines() if "│" in line]
    return [{"alarms": int(row[2]), "false": int(row[5])} for row in rows if row[2]]


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--mark", f"{RUN}@93s no", "--mark", f"{RUN}@31.5s fire"], "contradict each other"),
        (["--mark", f"{RUN}@93s"], "is no mark"),
        ([RUN, "--set", "blow=1 m"], "did you mean 'below'"),
        ([RUN, "--set", 'below="80 cm"', "--save", "2"], "there are only 1"),
        ([], "name a recording"),
    ],
)
def test_what_is_wrong_is_said(invoked, arguments, says):
    done = invoked("near", *arguments)
    assert done.exit_code == 2
    assert says in " ".join(done.output.split())


# The command ``test`` runs the tests of a configuration and says what failed, when and why.

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


def test_a_test_that_cannot_be_run_fails_and_the_others_go_on(tested: Tested) -> None:
    missing = '\n[[tests]]\ninput = { journal = "run.jsonl" }\nexpect.near = { raised = 1 }\n'
    result = tested(missing + PASSING)
    assert result.exit_code == 1
    assert "FAILED  test 1" in result.stdout
    assert "it could not be run: " in result.stdout
    assert "run.jsonl: there is no such file" in result.stdout
    assert "2 tests: 1 passed, 1 failed" in result.stdout


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
