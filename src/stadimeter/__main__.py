"""Run the command line: ``stadimeter``, or ``python -m stadimeter``."""

from __future__ import annotations

import gc
import os
import sys

# Loading libraries makes a hundred thousand objects that stay. At Python's own threshold of 700 the collector walks
# through all of them again and again: 0.17 s of the 1.25 s that `check` takes, on one core of a desktop.
OBJECTS_TO_COLLECT = 50_000


def main() -> None:
    """Run the command line and leave the process with its exit code."""
    gc.set_threshold(OBJECTS_TO_COLLECT)
    open_standard_streams()
    # None of our models has plugins. To look for them, pydantic reads a file of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from stadimeter.cli import main as command_line  # noqa: PLC0415 - only now: pydantic looks when it is loaded

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


if __name__ == "__main__":
    main()
