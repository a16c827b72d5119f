"""Long work says that it goes on: a moving line in a terminal, lines elsewhere, nothing for what is done at once."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType
from typing import IO

import pytest
import typer

from stadimeter.cli import exits


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exits, "FIRST_AFTER_S", 0.0)
    monkeypatch.delenv(exits.SWITCH)


@pytest.fixture
def ends() -> Iterator[list[int]]:
    kept: list[int] = []
    yield kept
    for each in kept:
        os.close(each)


def shown_while_working(monkeypatch: pytest.MonkeyPatch, reading: int, writing: IO[str]) -> str:
    """Return what comes first at the other end of standard error."""
    monkeypatch.setattr(sys, "stderr", writing)
    with exits.working("counting sheep"):
        return os.read(reading, 4096).decode() + (os.read(reading, 4096).decode() if writing.isatty() else "")


@pytest.mark.usefixtures("at_once")
def test_in_a_pipe_a_line_says_what_is_done(monkeypatch: pytest.MonkeyPatch, ends: list[int]) -> None:
    reading, writing = os.pipe()
    ends.append(reading)
    with os.fdopen(writing, "w", buffering=1) as stream:
        assert shown_while_working(monkeypatch, reading, stream) == "counting sheep …\n"


@pytest.mark.usefixtures("at_once")
def test_in_a_terminal_a_moving_line_says_so(monkeypatch: pytest.MonkeyPatch, ends: list[int]) -> None:
    monkeypatch.setenv("TERM", "xterm")
    reading, writing = os.openpty()
    ends.append(reading)
    with os.fdopen(writing, "w", buffering=1) as stream:
        assert "counting sheep" in shown_while_working(monkeypatch, reading, stream)


def test_what_is_done_at_once_is_not_announced(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(exits.count_items("abc", "counting", 3)) == ["a", "b", "c"]
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("at_once")
def test_who_wants_to_see_no_progress_sees_none(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STADIMETER_PROGRESS", "off")
    with exits.working("counting sheep"):
        pass
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("at_once")
def test_what_is_written_meanwhile_is_never_glued_to_the_moving_line(
    monkeypatch: pytest.MonkeyPatch, ends: list[int]
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    reading, writing = os.openpty()
    ends.append(reading)
    with os.fdopen(writing, "w", buffering=1) as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        with exits.working("counting sheep"):
            shown = os.read(reading, 4096).decode()
            while "sheep" not in shown:
                shown += os.read(reading, 4096).decode()
            typer.echo("a black one", err=True)
            while "a black one" not in shown:
                shown += os.read(reading, 4096).decode()
    before, after = shown.split("a black one")
    assert before.endswith(("\x1b[2K", "\r")), "the moving line was not cleared"
    assert after.startswith("\r\n")


@pytest.mark.usefixtures("at_once")
def test_a_command_that_takes_long_to_load_says_that_it_is_starting(
    monkeypatch: pytest.MonkeyPatch, ends: list[int]
) -> None:
    reading, writing = os.pipe()
    ends.append(reading)
    shown = []

    def load_slowly(module: str) -> ModuleType:
        shown.append(os.read(reading, 4096).decode())
        return import_module(module)

    main = import_module("stadimeter.cli.main")  # its package has a function of that name
    with os.fdopen(writing, "w", buffering=1) as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        monkeypatch.setattr(main, "import_module", load_slowly)
        monkeypatch.setattr(main, "SLOW_START_S", 0.0)
        typer.main.get_command(main.app).load("check")
    assert shown == ["starting …\n"]
