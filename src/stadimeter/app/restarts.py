"""How the program begins anew in its process, and knows afterwards that it did."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

# This variable of the environment tells a program that it began anew.
ENV_RESTARTED = "STADIMETER_RESTARTED"

# This one says which page the program before has left: what it says (a file descriptor), its process id, and more.
ENV_PAGE_LEFT = "STADIMETER_PAGE"

# A run that was started by a page finds here the process id of that page. It ends with it, and starts none.
ENV_PARENT_PAGE_PID = "STADIMETER_HAS_PAGE"

# A page that was started by a run finds here the process id of that run, with which it ends. A restart keeps it.
ENV_PARENT_RUN_PID = "STADIMETER_OF_RUN"

RESTARTING = "restart, as asked"


def begin_anew() -> None:
    """Replace this program by a new one with the same command line. Does not return.

    What a driver left open is closed by the kernel: also what a library opened that knows nothing of it.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    kept = {"0", "1", "2", *os.environ.get(ENV_PAGE_LEFT, "").split()[:1]}
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            os.set_inheritable(int(descriptor.name), descriptor.name in kept)
    os.environ[ENV_RESTARTED] = "1"
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606 - our own command line


def was_restarted() -> bool:
    """Return whether this program began anew."""
    return ENV_RESTARTED in os.environ
