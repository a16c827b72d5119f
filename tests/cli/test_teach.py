"""The commands ``what-if`` and ``teach``."""

from __future__ import annotations

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
