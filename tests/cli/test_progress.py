"""Long work says that it goes on: a moving line in a terminal, lines elsewhere, nothing for what is done at once."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from typing import IO

import pytest

from stadimeter.cli import progress


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FIRST_AFTER_S", 0.0)


@pytest.fixture
def ends() -> Iterator[list[int]]:
    kept: list[int] = []
    yield kept
    for each in kept:
        os.close(each)


def shown_while_working(monkeypatch: pytest.MonkeyPatch, reading: int, writing: IO[str]) -> str:
    """Return what comes first at the other end of standard error."""
    monkeypatch.setattr(sys, "stderr", writing)
    with progress.working("counting sheep"):
        return os.read(reading, 4096).decode() + os.read(reading, 4096).decode() * writing.isatty()


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
    assert list(progress.counted("abc", "counting", 3)) == ["a", "b", "c"]
    assert capsys.readouterr() == ("", "")
