"""Run the command line: ``stadimeter``, or ``python -m stadimeter``."""

from __future__ import annotations

import gc
import os
import sys
import threading
from contextlib import suppress
from typing import TextIO

# A command that has written nothing for this long says that it is starting: loading libraries may take long.
FIRST_SIGN_S = 1.0


def main() -> None:
    """Run the command line and leave the process with its exit code.

    Loading libraries makes a hundred thousand objects that stay, and little garbage. The collector would walk through
    all of them again and again, so it rests until the work of a command begins: see `stadimeter.cli.main`.
    """
    gc.disable()
    if os.environ.get("STADIMETER_PROGRESS") != "off":  # see `stadimeter.cli.progress`, which takes long to load
        give_first_sign()
    # None of our models has plugins. To look for them, pydantic reads a file of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from stadimeter.cli import main as command_line  # noqa: PLC0415 - only now: the collector must rest

    command_line()


def give_first_sign() -> None:
    """Say on standard error that this is starting, unless something is written within `FIRST_SIGN_S`."""
    is_written = threading.Event()
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # a program without a console has none
            _watch_first_write(stream, is_written)
    threading.Thread(target=_sign_if_silent, args=(is_written,), name="first sign", daemon=True).start()


def _watch_first_write(stream: TextIO, is_written: threading.Event) -> None:
    write = stream.write

    def write_first(text: str) -> int:
        is_written.set()
        vars(stream).pop("write", None)
        return write(text)

    stream.write = write_first  # type: ignore[method-assign]


def _sign_if_silent(is_written: threading.Event) -> None:
    if not is_written.wait(FIRST_SIGN_S) and sys.stderr is not None:
        with suppress(OSError, ValueError):  # nobody listens, and the work goes on
            sys.stderr.write("starting ...\n")
            sys.stderr.flush()


if __name__ == "__main__":
    main()
