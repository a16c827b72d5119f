"""A stepped clock on which the program can be stopped or killed while the world and the base's firmware live on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stadimeter.app.clock import SteppedClock

# What is called from here lives outside the program: the firmware behind the emulated port.
_OUTSIDE = "stadimeter.simulation."


class StagedClock(SteppedClock):
    """A stepped clock for one program and the world around it.

    All computing takes no time, so a program can only be stopped where it sleeps on this clock.
    """

    def __init__(self) -> None:
        super().__init__()
        self._outside: set[int] = set()

    def call_every(self, period_s: float, callback: Callable[[float], None]) -> Callable[[], None]:
        """Call ``callback(now_s)`` every ``period_s`` seconds. A callback of the simulation lives outside."""
        owner: Any = getattr(callback, "__self__", None)
        if type(owner).__module__.startswith(_OUTSIDE):
            return self.call_outside(period_s, callback)
        return super().call_every(period_s, callback)

    def call_outside(self, period_s: float, callback: Callable[[float], None]) -> Callable[[], None]:
        """Call something that goes on while the program is stopped."""
        cancel = super().call_every(period_s, callback)
        self._outside.add(id(self._periodic[-1]))
        return cancel

    def call_at(self, time_s: float, callback: Callable[[], None]) -> None:
        """Call something outside the program once, at a time."""

        def once(_now_s: float) -> None:
            cancel()
            callback()

        cancel = self.call_outside(max(0.0, time_s - self.now_s()), once)

    def stop_program(self, until_s: float, is_over: Callable[[], bool]) -> None:
        """Let time pass for everything but the program, until a time or until ``is_over``. Then the program goes on.

        What the program should have done meanwhile is due once, at the end, as the timers of a stopped process are.
        """
        while not is_over() and (due := self._next_outside(until_s)):
            self._move_to(due.due_s)
            due.due_s += due.period_s
            due.callback(self.now_s())
        self._move_to(self.now_s() if is_over() else until_s)
        for entry in self._periodic:
            entry.due_s = max(entry.due_s, self.now_s())

    def _next_outside(self, until_s: float) -> Any:
        outside = [entry for entry in self._periodic if id(entry) in self._outside and entry.due_s <= until_s]
        return min(outside, key=lambda entry: entry.due_s, default=None)
