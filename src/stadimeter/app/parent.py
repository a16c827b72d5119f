"""The process that started this one, and how its end is noticed, however it ended.

A request to the kernel to be killed with the parent would be about the thread that started us, which ends sooner.
"""

from __future__ import annotations

import os
from contextlib import suppress


def watched_parent(named: str) -> int | None:
    """Return a file descriptor that can be read as soon as our parent is gone.

    Args:
        named: The parent's process id, as it left it in our environment; anything else stands for no parent to watch.
    """
    if not named.isdecimal():
        return None
    with suppress(ProcessLookupError):
        process = os.pidfd_open(int(named))
        if os.getppid() == int(named):
            return process
        os.close(process)  # the parent went before we looked, and the number is another's now
    gone, end = os.pipe()
    os.close(end)
    return gone
