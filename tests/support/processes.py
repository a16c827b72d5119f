"""Processes as the kernel shows them."""

from __future__ import annotations

import os
from pathlib import Path


def is_running(pid: int) -> bool:
    """Return whether a process is there and has not ended; one that nobody waits for stays as a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def children(pid: int) -> list[int]:
    """Return the processes that a process has started, in whichever thread."""
    threads = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(each) for thread in threads for each in thread.read_text().split()]


def is_suspended(child: int) -> bool:
    """Return whether a child of ours was stopped by a signal; once for each time that it was."""
    found = os.waitid(os.P_PID, child, os.WSTOPPED | os.WNOHANG)
    return found is not None and found.si_code == os.CLD_STOPPED
