"""The interface of a clock to the rest of the program. The clocks themselves live in `stadimeter.app.clock`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

DAY_S = 86400.0


class TaskEndedError(BaseException):
    """A task that runs beside others is no longer wanted. No driver catches it: it is no `Exception`."""


class Clock(Protocol):
    """A monotonic clock in seconds, real or stepped.

    The wall clock is never used for control: a Raspberry Pi without a clock chip jumps at its first time sync.
    """

    def now_s(self) -> float:
        """Return the time in seconds since an arbitrary start. It never goes back."""
        ...

    def sleep_until_s(self, time_s: float) -> None:
        """Return when the clock shows ``time_s`` or later; at once if it already does."""
        ...

    def call_every(self, period_s: float, callback: Callable[[float], None]) -> Callable[[], None]:
        """Call ``callback(now_s)`` every ``period_s`` seconds until the returned function is called.

        A real clock calls from a thread of its own; a stepped clock calls from within `sleep_until_s`, in the order
        of time, so that a simulation needs no threads.
        """
        ...

    def run_beside(self, task: Callable[[], None]) -> Callable[[], None]:
        """Run ``task`` once, beside the caller; the returned function has it end at its next sleep on this clock.

        For what takes seconds and may hold nothing up. A real clock runs it in a thread of its own; a stepped clock
        within `sleep_until_s`, from each of its sleeps to the next, in the order of time. To end it, its sleep raises
        `TaskEndedError`.
        """
        ...
