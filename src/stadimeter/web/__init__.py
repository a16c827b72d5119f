"""The page: a process of its own that shows a run, sets it up and operates it, and computes nothing itself."""

from __future__ import annotations

import sys


def python(module: str) -> list[str]:
    """Return the command that runs a module of ours as a process, by this interpreter and its libraries.

    With ``-P`` no module is taken from the folder that we happen to be in.
    """
    flags = ["-P", "-s"] if sys.flags.no_user_site else ["-P"]
    return [sys.executable, *flags, "-m", module]
