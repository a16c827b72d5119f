"""The command that prints the event log."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli import events
from stadimeter.cli.main import app


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(events, "SERVICE_STATE", tmp_path)
    return tmp_path


def printed(*words: object) -> Result:
    return CliRunner().invoke(app, ["events", *map(str, words)])


def test_the_newest_lines_of_all_files_are_printed_in_the_order_of_time(folder: Path) -> None:
    for name, numbers in (("box.log.2", (1, 2)), ("box.log.1", (3, 4)), ("box.log", (5, 6))):
        (folder / name).write_text("".join(f"line {number}\n" for number in numbers))
    assert printed().stdout.splitlines() == [f"line {number}" for number in range(1, 7)]
    assert printed("-n", 3).stdout.splitlines() == ["line 4", "line 5", "line 6"]
    assert printed(folder / "box.log", "--lines", 1).stdout == "line 6\n"


def test_without_a_log_it_says_who_keeps_one(folder: Path) -> None:
    found = printed()
    assert (found.exit_code, found.stderr) == (
        2,
        f"error: there is no event log in {folder}: only a service keeps one; or name the LOG\n",
    )
    assert printed(folder / "absent.log").exit_code == 2


def test_a_pipe_is_no_log_and_is_not_waited_for(folder: Path) -> None:
    os.mkfifo(folder / "box.log")
    assert printed().exit_code == 2
