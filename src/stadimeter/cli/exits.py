"""Exit codes, and errors as one clear line each on standard error, never a traceback for what a user did."""

from __future__ import annotations

import errno
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, NoReturn, TypeVar

import typer

from stadimeter.errors import ConfigError, Problem, StadimeterError, reason_of

DONE = 0
NOT_FOUND = 1
WRONG = 2

# Error numbers of writing to a closed pipe or terminal. Devices may fail with the same numbers.
WRITING_FAILS = frozenset({errno.EPIPE, errno.EIO})

# Of a disk that is full, for all or for this user, and of a file that may not become larger.
NO_SPACE = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})

# OpenCV's ``StsNoMem``, the code of its error.
CV_NO_MEMORY = -4

# More lines than this are not read, and a file that is no configuration may have ten thousand errors.
MAX_SHOWN = 100


@contextmanager
def plain_errors() -> Iterator[None]:
    """Turn every error that stadimeter raises on purpose into its lines on standard error and exit code 2.

    So does running out of memory. If the reader of our output ends, such as `head`, the command ends with 0.
    """
    try:
        yield
    except ConfigError as error:
        for problem in error.problems[:MAX_SHOWN]:
            typer.echo(f"error: {problem}", err=True)
        if len(error.problems) > MAX_SHOWN:
            typer.echo(f"error: and {len(error.problems) - MAX_SHOWN} more", err=True)
        raise typer.Exit(WRONG) from error
    except StadimeterError as error:
        for line in str(error).splitlines():
            typer.echo(f"error: {line}", err=True)
        raise typer.Exit(WRONG) from error
    except (Exception, SystemExit) as error:
        instead = _replace_error(error)
        if instead is None:
            raise
        raise instead from error


def _replace_error(error: BaseException) -> Exception | None:
    """Return the exception that ends the command instead of an uncaught error; None if that error does."""
    if isinstance(error, SystemExit) and isinstance(error.__context__, BrokenPipeError):  # Rich's, in place of it
        return typer.Exit(DONE)
    if isinstance(error, SystemExit):  # nothing of ours ends that way, and the program would end without a word
        return RuntimeError(f"a driver or library asked for the end of the program: {error!r}")
    if _is_out_of_memory(error):
        words = " ".join(str(error).split()) or type(error).__name__
        typer.echo(f"error: this computer, or a limit set for us, has no more memory: {words}", err=True)
        return typer.Exit(WRONG)
    if not isinstance(error, OSError) or error.errno not in WRITING_FAILS:
        return None
    if _is_reader_gone():
        _give_output_up()
        return typer.Exit(DONE)
    # It is a device's. Click would take an EPIPE for our output's, and end without a word.
    return RuntimeError(f"{type(error).__name__}: {error}")


def end_without_space(error: OSError) -> NoReturn:
    """End the process in a line, since a disk is full: that of standard output, or of a file that is not looked after.

    Any other error is raised again.
    """
    if error.errno not in NO_SPACE:
        raise error
    _give_output_up()
    try:
        typer.echo(f"error: {error.filename or 'what is printed'} cannot be written: {reason_of(error)}", err=True)
    except OSError:  # standard error goes to the same disk
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115, PTH123 - until the end
    sys.exit(WRONG)


def _give_output_up() -> None:
    """Write the rest of our output nowhere: what is left in its buffer would fail again at the end of the process."""
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123 - until the end


def _is_reader_gone() -> bool:
    """Check whether the reader of our output has ended, such as `head`, or the terminal is gone."""
    poll = select.poll()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # closed, or none that the system knows
            poll.register(stream.fileno(), 0)
    return any(seen & (select.POLLERR | select.POLLHUP) for _, seen in poll.poll(0))


def _is_out_of_memory(error: BaseException) -> bool:
    """Check whether that is it: Python, the system, OpenCV and threads each say it in a way of their own."""
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    is_cv = getattr(error, "code", None) == CV_NO_MEMORY
    return isinstance(error, MemoryError) or is_cv or str(error) == "can't start new thread"


# The configuration that `stadimeter init` writes.
USUAL = Path("stadimeter.toml")

ConfigArgument = Annotated[
    Path | None,
    typer.Argument(metavar="[CONFIG]", help=f"The configuration, a TOML file; without it, {USUAL} in this folder."),
]


def configuration_path(named: Path | None) -> Path:
    """Return the configuration that is meant, and say on standard error which one that is if it was not named.

    Raises:
        ConfigError: None was named, and there is none in this folder.
    """
    if named is not None:
        return named
    if not USUAL.is_file():
        raise ConfigError(
            f"name a configuration: there is no {USUAL} in this folder. `stadimeter init` writes one, and "
            "`stadimeter demo` needs none"
        )
    typer.echo(f"using {USUAL}", err=True)
    return USUAL


def say_note(words: str) -> None:
    """Say on standard error what is worth knowing and no error."""
    typer.echo(f"note: {words}", err=True)


def read_option(parse: Callable[[str], float], text: str, option: str) -> float:
    """Read the text of an option, such as a length; the `ConfigError` names the option."""
    try:
        return parse(text)
    except ValueError as error:
        raise ConfigError([Problem(str(error), key=option)]) from error


def make_folder(folder: Path, option: str) -> None:
    """Make the folder that an option names, if it is not there; the `ConfigError` names the option."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError([Problem(f"the folder {folder} cannot be made: {reason_of(error)}", key=option)]) from error


# Says on standard error that a command works: in a terminal with a moving line, elsewhere with one that stays ---------

# Work that ends sooner is not announced, in seconds.
FIRST_AFTER_S = 0.5

# This variable of the environment, set to ``off``, keeps it quiet: for logs, and for pages that show output.
SWITCH = "STADIMETER_PROGRESS"

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


def _show(now: list[str], is_over: threading.Event, after_s: float | None) -> None:
    began_s = time.monotonic()
    if os.environ.get(SWITCH) == "off" or is_over.wait(FIRST_AFTER_S if after_s is None else after_s):
        return
    with suppress(OSError):  # the terminal is gone; the work goes on
        if not sys.stderr.isatty():
            typer.echo(f"{now[0]} …", err=True)
            return
        from rich import console, live, spinner  # noqa: PLC0415 - not needed for what is done at once

        dots = spinner.Spinner("dots", now[0])
        with live.Live(dots, console=console.Console(stderr=True), transient=True, redirect_stdout=False):
            while not is_over.wait(0.25):
                dots.update(text=f"{now[0]}, {time.monotonic() - began_s:.0f} s so far")
