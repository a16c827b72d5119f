"""The commands ``tune``, ``what-if``, ``teach`` and ``test``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli.main import app
from stadimeter.workbench.tuning import proposing as tuning
from stadimeter.workbench.tuning import proposing as tuning_candidates
from support.false_alarm import BY_S, CONFIGURATION, STAYED_S, record
from support.noisy_journal import KnownNoise, write_noisy_journal
from support.simulated_run import SIMULATED_BALL

# The command ``tune``.

NOISY_RULES = """
[camera]
driver = "simulated"
[camera.model]
width_px = 640
height_px = 480
fx_px = 1000.0
[targets.ball]
detector = "ideal"
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
[rules.near]
when = { below = "2 m", deadband = "5 cm" }
[rules.gone]
when = { lost = true }
"""


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "rules.toml"
    path.write_text(NOISY_RULES)
    return path


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(tuning, "FRAMES_A_CLEARANCE", 300)
    monkeypatch.setattr(tuning, "CLEARANCES", (-1.5, 0.0, 1.0, 2.0, 3.0, 3.5))
    monkeypatch.setattr(tuning_candidates, "PROBABILITIES", (0.5, 0.7, 0.9, 0.99))
    monkeypatch.setattr(tuning_candidates, "OFF_DELAYS_S", (0.0, 1.0))
    monkeypatch.setattr(tuning, "CROSSINGS", 4)
    monkeypatch.setattr(tuning, "HOVER_FRAMES", 300)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_noisy_journal(tmp_path_factory.mktemp("tune") / "quiet.jsonl", lambda _: 3.0, KnownNoise(), seconds=40)


def run(*arguments):
    return CliRunner().invoke(app, ["tune", *(str(each) for each in arguments)])


@pytest.mark.long
def test_where_no_setting_keeps_to_what_was_asked_for_none_is_proposed(config, tmp_path, quick):
    hovering = write_noisy_journal(tmp_path / "hovering.jsonl", lambda _: 2.0, KnownNoise(), seconds=40)
    done = run("near", hovering, "--config", config)
    assert done.exit_code == 1
    assert "so none is proposed" in done.output
    assert "within one standard deviation of the threshold" in done.output
    assert "For [rules.near]" not in done.output
    assert "→" not in done.output
    assert json.loads(run("near", hovering, "--config", config, "--json").stdout)["toml"] == []


@pytest.mark.long
def test_the_lines_for_the_rule_and_what_they_rest_on_are_printed(config, recording, quick):
    done = run("near", recording, "--config", config)
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    begin = lines.index("For [rules.near]:")
    assert lines[begin + 1].startswith('when = { below = "2 m", probability = 0.5, deadband_sigmas = ')
    assert lines[begin + 1].endswith(', deadband = "0.05 m" }')
    assert lines[begin + 2] == 'on_delay = "0 s"'
    assert lines[begin + 3].startswith('off_delay = "')
    assert "The recordings alone support no better than" in done.output
    assert "For 1 a day, record 72 h without a true alarm." in done.output
    assert "the figures are extrapolated" in done.output
    assert "Noise: ±" in done.output


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["neer"], "did you mean 'near'?"),
        (["gone"], "only such alarms can be tuned"),
        (["near", "--closing-speed", "2"], "has no unit"),
        (["near", "--event", "soon"], "not a number with a unit"),
    ],
)
def test_what_cannot_be_tuned_is_said(config, recording, quick, arguments, says):
    done = run(arguments[0], recording, "--config", config, *arguments[1:])
    assert done.exit_code == 2
    assert says in done.output


# The commands ``what-if`` and ``teach``.


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("teach")
    record(found, 1_700_000_000.0)
    return found


@pytest.fixture
def invoked(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(folder)
    Path("stadimeter.toml").write_text(CONFIGURATION)

    def invoke(*arguments: str) -> Result:
        return CliRunner().invoke(app, [*arguments, "--config", "stadimeter.toml"])

    return invoke


RUN = "recordings/evening.mcap"
MARKS = ("--mark", f"{RUN}@{BY_S}s no", "--mark", f"{RUN}@{STAYED_S}s fire")


@pytest.mark.long
def test_another_threshold_is_tried_and_nothing_is_changed(invoked):
    done = invoked("what-if", "near", RUN, "--set", 'below="80 cm"')
    assert done.exit_code == 0, done.output
    assert "below: 80 cm; it was 1.00 m (3.3 ft)" in done.output
    assert "near would have fired 2 times in 4 minutes of 1 recording: 0 of them new, 2 of yours missed." in done.output
    assert Path("stadimeter.toml").read_text() == CONFIGURATION


@pytest.mark.long
def test_marks_are_met_and_saved_with_a_test_that_passes(invoked):
    done = invoked("teach", "near", *MARKS, "--write")
    assert done.exit_code == 0, done.output
    assert "with 1 test" in done.output
    assert CliRunner().invoke(app, ["test", "stadimeter.toml"]).exit_code == 0


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["teach", "near", "--mark", f"{RUN}@93s no", "--mark", f"{RUN}@31.5s fire"], "contradict each other"),
        (["teach", "near", "--mark", f"{RUN}@93s"], "is no mark"),
        (["what-if", "near", RUN, "--set", "blow=1 m"], "did you mean 'below'"),
    ],
)
def test_what_is_wrong_is_said(invoked, arguments, says):
    done = invoked(*arguments)
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
