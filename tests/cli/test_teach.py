"""The commands ``what-if`` and ``teach``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli.main import app
from support.false_alarm import BY_S, CONFIGURATION, STAYED_S, record


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
def test_what_was_taught_before_keeps_its_test_when_the_same_recording_teaches_again(invoked):
    invoked("teach", "near", *MARKS, "--write")
    first = set(Path("tests").iterdir())
    done = invoked("teach", "near", "--mark", f"{RUN}@{BY_S}s fire", "--mark", f"{RUN}@{STAYED_S}s fire", "--write")
    assert done.exit_code == 0, done.output
    assert len(set(Path("tests").iterdir()) - first) == 1
    assert CliRunner().invoke(app, ["check", "stadimeter.toml"]).exit_code == 0
    tested = CliRunner().invoke(app, ["test", "stadimeter.toml"])
    assert "1 passed" in tested.output  # what contradicts the first test is not hidden
    assert "1 failed" in tested.output


@pytest.mark.long
def test_a_recording_that_was_cut_says_so(invoked):
    whole = Path(RUN).read_bytes()
    Path("cut.mcap").write_bytes(whole[: len(whole) // 2])
    done = invoked("what-if", "near", "cut.mcap", "--set", "below=80 cm")
    assert done.exit_code == 0, done.output
    assert "Its end is missing" in done.output


@pytest.mark.long
def test_the_object_has_the_alarms_before_and_after(invoked):
    done = invoked("teach", "near", *MARKS, "--json")
    told = json.loads(done.stdout)
    assert len(told["changes"]) == 1
    assert len(told["recordings"][0]["before"]) == 4


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["teach", "near", "--mark", f"{RUN}@93s no", "--mark", f"{RUN}@31.5s fire"], "contradict each other"),
        (["teach", "near", "--mark", f"{RUN}@93s"], "is no mark"),
        (["teach", "near", "--mark", f"{RUN}@93s..20s no"], "ends before it begins"),
        (["teach", "near", "--mark", "gone.jsonl@93s no"], "gone.jsonl"),
        (["teach", "near", "--mark", f"{RUN}@900s no"], "is after the end of what was read of it"),
        (["teach", "far", "--mark", f"{RUN}@93s no"], "there is no alarm 'far'"),
        (["what-if", "near", RUN, "--set", "blow=1 m"], "did you mean 'below'"),
        (["what-if", "near", RUN, "--set", "below"], "is not of the form"),
        (["what-if", "near", RUN, "--set", "below=0 m"], "below"),
    ],
)
def test_what_is_wrong_is_said(invoked, arguments, says):
    done = invoked(*arguments)
    assert done.exit_code == 2
    assert says in " ".join(done.output.split())
