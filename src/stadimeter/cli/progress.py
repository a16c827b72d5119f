"""Says on standard error that a command works: in a terminal with a moving line, elsewhere with a line now and then."""

from __future__ import annotations

import os
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, TypeVar

import typer

# Work that ends sooner is not announced, in seconds.
FIRST_AFTER_S = 0.5

# This variable of the environment, set to ``off``, keeps it quiet: for logs, and for pages that show output.
SWITCH = "STADIMETER_PROGRESS"

# Seconds between lines of progress where the output is no terminal.
EVERY_S = 15.0

_T = TypeVar("_T")
Say = Callable[[str], None]


@contextmanager
def working(doing: str, after_s: float | None = None) -> Iterator[Say]:
    """Show that a command works, soon after it began and until the block ends.

    A thread shows it, so the computation needs no calls. Nothing is written on standard output.

    Args:
        doing: What it does, such as ``reading the recording``.
        after_s: How soon; `FIRST_AFTER_S` if left out.

    Yields:
        Changes what is shown, when the next part of the work begins.
    """
    now = [doing]
    is_over = threading.Event()
    shown = threading.Thread(target=_show, args=(now, is_over, after_s), name="progress", daemon=True)
    shown.start()
    try:
        yield lambda words: now.__setitem__(0, words)
    finally:
        is_over.set()
        shown.join()


def count_items(items: Iterable[_T], doing: str, total: int) -> Iterator[_T]:
    """Go through items while `working` shows how many are done."""
    with working(doing) as say:
        for number, item in enumerate(items, start=1):
            say(f"{doing}: {number} of {total}")
            yield item


def goes_to_file(stream: TextIO) -> bool:
    """Check whether what is written there goes to a file, and to no terminal, not even by a pipe."""
    try:
        return stat.S_ISREG(os.fstat(stream.fileno()).st_mode)
    except (OSError, ValueError):  # closed, or in memory
        return False


def _show(now: list[str], is_over: threading.Event, after_s: float | None) -> None:
    began_s = time.monotonic()
    if os.environ.get(SWITCH) == "off" or is_over.wait(FIRST_AFTER_S if after_s is None else after_s):
        return
    with suppress(OSError):  # the terminal is gone; the work goes on
        if sys.stderr.isatty():
            _show_moving(now, is_over, began_s)
        else:
            _show_in_lines(now, is_over, began_s)


def _show_moving(now: list[str], is_over: threading.Event, began_s: float) -> None:
    from rich import console, file_proxy, live, spinner  # noqa: PLC0415 - not needed for what is done at once

    class Above(file_proxy.FileProxy):
        encoding = "utf-8"  # a FileProxy names none, and typer then writes past it: glued to the moving line
        errors = "replace"

    terminal, dots = console.Console(stderr=True), spinner.Spinner("dots", now[0])
    line = live.Live(dots, console=terminal, transient=True, redirect_stdout=False, redirect_stderr=False)
    with _write_above(lambda stream: Above(terminal, stream)), line:
        while not is_over.wait(0.25):
            dots.update(text=_words(now[0], began_s))


@contextmanager
def _write_above(above: Callable[[TextIO], Any]) -> Iterator[None]:
    """Put above the moving line what is written on the terminal meanwhile. What goes elsewhere still goes there."""
    before = sys.stdout, sys.stderr
    if sys.stdout.isatty():
        sys.stdout = above(sys.stdout)
    sys.stderr = above(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _show_in_lines(now: list[str], is_over: threading.Event, began_s: float) -> None:
    typer.echo(f"{now[0]} …", err=True)
    while not is_over.wait(EVERY_S):
        typer.echo(_words(now[0], began_s), err=True)


def _words(doing: str, began_s: float) -> str:
    return f"{doing}, {time.monotonic() - began_s:.0f} s so far"
