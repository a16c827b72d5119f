"""How the program begins anew in its process, and knows afterwards that it did."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

RESTARTED = "STADIMETER_RESTARTED"
"""This variable of the environment tells a program that it began anew."""

RESTARTING = "restart, as asked"


def begin_anew() -> None:
    """Replace this program by a new one with the same command line. Does not return.

    What a driver left open is closed by the kernel: also what a library opened that knows nothing of it.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            if int(descriptor.name) > 2:
                os.set_inheritable(int(descriptor.name), False)
    os.environ[RESTARTED] = "1"
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606 - our own command line


def was_restarted() -> bool:
    """Return whether this program began anew."""
    return RESTARTED in os.environ
