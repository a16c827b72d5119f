"""How long ago something was, across restarts of the program and of the computer.

Timers run on a monotonic clock, which begins anew with the computer. What was remembered in the same boot is as old as
that clock says. After another boot only the wall clock can tell, if it was right both times; if it cannot, no time has
passed: a timer may then end late, and never early. A wall clock that is set while the computer runs moves no timer.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from stadimeter.app.wall_time import is_synchronised

STEPPED = "stepped"
"""The name of the clock of simulations and recordings: it begins at the same time in each run."""

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A moment on the run's clock and on the wall clock.

    Attributes:
        clock: Which monotonic clock it is: that of one boot of the computer, or a stepped one.
        unix_s: On the wall clock, in seconds since 1970.
        is_synchronised: Whether the wall clock was right.
    """

    clock: str
    at_s: float
    unix_s: float
    is_synchronised: bool


def clock_name(*, is_live: bool, boot_id: Path = BOOT_ID) -> str:
    """Return the name of a run's clock.

    Args:
        is_live: Whether the run is on the computer's clock.
        boot_id: The file in which the kernel tells one boot from another.

    Returns:
        A name that no other boot has; if the kernel gives none, one that no other run has.
    """
    if not is_live:
        return STEPPED
    try:
        return boot_id.read_text(encoding="ascii").strip()
    except OSError:
        return f"unknown boot at {time.time_ns()}"


def moment(
    clock: str,
    at_s: float,
    *,
    unix_s: Callable[[], float] = time.time,
    is_right: Callable[[], bool] = is_synchronised,
) -> Moment:
    """Return this moment.

    Args:
        clock: The name of the run's clock.
        unix_s: Tells the time of the wall clock.
        is_right: Tells whether that can be believed.
    """
    return Moment(clock=clock, at_s=at_s, unix_s=unix_s(), is_synchronised=is_right())


def elapsed_s(before: Moment, now: Moment) -> float:
    """Return how much time has passed between two moments.

    Returns:
        In seconds, never below 0; 0 if nobody can tell.
    """
    if before.clock == now.clock:
        return max(0.0, now.at_s - before.at_s)
    if before.is_synchronised and now.is_synchronised:
        return max(0.0, now.unix_s - before.unix_s)
    return 0.0
