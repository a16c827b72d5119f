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
    open_standard_streams()
    if os.environ.get("STADIMETER_PROGRESS") != "off":  # see `stadimeter.cli.progress`, which takes long to load
        give_first_sign()
    # None of our models has plugins. To look for them, pydantic reads a file of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from stadimeter.cli import main as command_line  # noqa: PLC0415 - only now: the collector must rest

    command_line()


def open_standard_streams() -> None:
    """Open the null device as each standard stream that is closed, as ``<&-`` and some services leave them.

    Else the first file that we open, such as a robot's serial port, gets the number of standard output, and whatever
    a library prints goes there.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free, which is this one
        if getattr(sys, name) is None:
            stream = open(os.devnull, "r" if number == 0 else "w", encoding="utf-8")  # noqa: SIM115, PTH123 - until the end
            setattr(sys, name, stream)


def give_first_sign() -> None:
    """Say on standard error that this is starting, unless something is written within `FIRST_SIGN_S`."""
    is_written = threading.Event()
    for stream in (sys.stdout, sys.stderr):
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
    if not is_written.wait(FIRST_SIGN_S):
        with suppress(OSError, ValueError):  # nobody listens, and the work goes on
            sys.stderr.write("starting ...\n")
            sys.stderr.flush()


if __name__ == "__main__":
    main()
