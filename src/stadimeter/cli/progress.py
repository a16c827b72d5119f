"""Says on standard error that a command works: in a terminal with a moving line, elsewhere with a line now and then."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TypeVar

import typer

FIRST_AFTER_S = 0.5
"""What is done sooner is not announced."""

EVERY_S = 15.0
"""Lines for whoever reads a log come this seldom."""

_T = TypeVar("_T")
Say = Callable[[str], None]


@contextmanager
def working(doing: str) -> Iterator[Say]:
    """Show that a command works, soon after it began and until the block ends.

    A thread of its own shows it, so what is computed need not know. Nothing is written on standard output.

    Args:
        doing: What it does, such as ``reading the recording``.

    Yields:
        Changes what is shown, when the next part of the work begins.
    """
    now = [doing]
    is_over = threading.Event()
    shown = threading.Thread(target=_show, args=(now, is_over), name="progress", daemon=True)
    shown.start()
    try:
        yield lambda words: now.__setitem__(0, words)
    finally:
        is_over.set()
        shown.join()


def counted(items: Iterable[_T], doing: str, total: int) -> Iterator[_T]:
    """Go through items while `working` shows how many are done."""
    with working(doing) as say:
        for number, item in enumerate(items, start=1):
            say(f"{doing}: {number} of {total}")
            yield item


def _show(now: list[str], is_over: threading.Event) -> None:
    began_s = time.monotonic()
    if is_over.wait(FIRST_AFTER_S):
        return
    with suppress(OSError):  # whoever looked on is gone, and the work goes on
        if sys.stderr.isatty():
            _show_moving(now, is_over, began_s)
        else:
            _show_in_lines(now, is_over, began_s)


def _show_moving(now: list[str], is_over: threading.Event, began_s: float) -> None:
    from rich.console import Console  # noqa: PLC0415 - what is done at once needs none

    with Console(stderr=True).status(now[0]) as status:
        while not is_over.wait(0.25):
            status.update(_words(now[0], began_s))


def _show_in_lines(now: list[str], is_over: threading.Event, began_s: float) -> None:
    typer.echo(f"{now[0]} …", err=True)
    while not is_over.wait(EVERY_S):
        typer.echo(_words(now[0], began_s), err=True)


def _words(doing: str, began_s: float) -> str:
    return f"{doing}, {time.monotonic() - began_s:.0f} s so far"
