"""Exit codes, and errors as one clear line each on standard error, never a traceback for what a user did."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from stadimeter.errors import ConfigError, StadimeterError

DONE = 0
NOT_FOUND = 1
WRONG = 2

_READER_GONE = frozenset({errno.EPIPE, errno.EIO})
"""The reader of our output has enough, such as `head`; or the terminal is gone."""

MOST_SHOWN = 100
"""More lines than this are not read, and a file that is no configuration may have ten thousand errors."""


@contextmanager
def plain_errors() -> Iterator[None]:
    """Turn every error that stadimeter raises on purpose into its lines on standard error and exit code 2."""
    try:
        yield
    except ConfigError as error:
        for problem in error.problems[:MOST_SHOWN]:
            typer.echo(f"error: {problem}", err=True)
        if len(error.problems) > MOST_SHOWN:
            typer.echo(f"error: and {len(error.problems) - MOST_SHOWN} more", err=True)
        raise typer.Exit(WRONG) from error
    except StadimeterError as error:
        for line in str(error).splitlines():
            typer.echo(f"error: {line}", err=True)
        raise typer.Exit(WRONG) from error
    except OSError as error:
        if error.errno not in _READER_GONE:
            raise
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123 - nothing is left to write to at exit
        raise typer.Exit(DONE) from None
