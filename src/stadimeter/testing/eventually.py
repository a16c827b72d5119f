"""Waiting for what another thread or program is about to do."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

ResultT = TypeVar("ResultT")


def eventually(condition: Callable[[], ResultT], within_s: float = 120.0) -> ResultT:
    """Wait until a condition returns something true, else raise `AssertionError`.

    Args:
        within_s: How long a condition that never comes true is waited for. It is no measurement: a machine at load 20
            takes ten times as long for everything.
    """
    until_s = time.monotonic() + within_s
    while not (result := condition()):
        assert time.monotonic() < until_s, f"this did not become true within {within_s:g} s: {result!r}"
        time.sleep(0.005)
    return result
