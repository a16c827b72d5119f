"""Push buttons: read every 20 ms beside the loop, debounced, and turned into operator commands.

A press acts when the button is let go; one that stops outputs acts as soon as the button is down, also if it is down
when the run begins. A pin that is shorted, or a button that something leans on, is never let go: otherwise it does
nothing, and `Loop.trouble` says so. So with one that is down when the run begins, or after a pause in which nobody
looked at it: how long it has been down is not known then.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from stadimeter.actuators.protocol import Button
from stadimeter.config.models import ButtonTable
from stadimeter.core.clock import Clock
from stadimeter.core.operator import OperatorAction, OperatorCommand
from stadimeter.errors import DriverError

PERIOD_S = 0.02
DEBOUNCE_S = 0.03
"""Contacts bounce for a few milliseconds; a level counts when it has held for this long."""

STUCK_S = 10.0
"""What is held for longer than this was not pressed by a finger."""

UNSEEN_S = 0.5
"""After a longer pause between two looks, what the button did meanwhile is not known. A shorter one cannot turn a tap
into a long press, which takes a second at least."""

OPEN_AGAIN_S = 5.0
"""A button whose driver failed is opened again this often."""


class Presses:
    """Finds the presses in the level of a button that is looked at again and again.

    Attributes:
        is_down: The level, debounced.
    """

    def __init__(self, *, is_down: bool, now_s: float) -> None:
        self.is_down = self._newest = is_down
        self._newest_since_s = self._looked_at_s = now_s
        self._down_since_s = -math.inf  # unless it is seen to go down

    def look(self, *, is_down: bool, now_s: float) -> float | None:
        """Take in the level at a time; return how long a press lasted, in seconds, if its end is known now."""
        if now_s - self._looked_at_s > UNSEEN_S:
            self._down_since_s = -math.inf
        self._looked_at_s = now_s
        if is_down != self._newest:
            self._newest, self._newest_since_s = is_down, now_s
        if is_down == self.is_down or now_s - self._newest_since_s < DEBOUNCE_S:
            return None
        self.is_down = is_down
        if is_down:
            self._down_since_s = self._newest_since_s
            return None
        return self._newest_since_s - self._down_since_s

    def is_stuck(self) -> bool:
        """Return whether it is held down for longer than anybody presses a button, or since the beginning."""
        return self.is_down and self._looked_at_s - self._down_since_s > STUCK_S


class PushButton:
    """A push button of a run."""

    def __init__(self, driver: Button, name: str, table: ButtonTable, clock: Clock) -> None:
        self._driver = driver
        self._name = name
        self._table = table
        self._clock = clock
        self._presses: Presses | None = None
        self._commands: deque[OperatorCommand] = deque()
        self._count = 0
        self._fault = ""
        self._retry_at_s = 0.0
        self._cancel: Callable[[], None] | None = None

    def open(self) -> None:
        """Take the device, and begin to look at it; `DriverError` if that is impossible."""
        self._driver.open()
        self._look(self._clock.now_s())
        self._cancel = self._clock.call_every(PERIOD_S, self._look_safely)

    def open_later(self, error: DriverError) -> bool:
        """Go on without it after `open` failed, and try again and again; return that this makes sense."""
        self._fail(error, self._clock.now_s())
        self._cancel = self._clock.call_every(PERIOD_S, self._look_safely)
        return True

    def commands(self) -> tuple[OperatorCommand, ...]:
        """Return what it has asked for since the last call, oldest first. Never waits."""
        return tuple(self._commands.popleft() for _ in range(len(self._commands)))

    def trouble(self) -> str:
        """Return in words what is wrong with it; empty if nothing is."""
        if self._fault:
            return f"button {self._name}: {self._fault}"
        presses = self._presses  # another thread may put it away
        if presses is None or not presses.is_stuck():
            return ""
        return f"button {self._name}: it is held down all the time, or its wires touch; it does nothing until let go"

    def close(self) -> None:
        """Cease to look, and release the device. May be called any number of times."""
        cancel, self._cancel = self._cancel, None
        if cancel is not None:
            cancel()
        self._driver.close()

    def _look_safely(self, now_s: float) -> None:
        """Look once; a driver that failed is opened again now and then. Whatever it raises must not end the looking."""
        if self._fault and now_s < self._retry_at_s:
            return
        try:
            if self._fault:
                self._driver.open()
            self._look(now_s)
            self._fault = ""
        except BaseException as error:  # noqa: BLE001 - told by `trouble`
            self._fail(error, now_s)

    def _fail(self, error: BaseException, now_s: float) -> None:
        self._fault = str(error) or type(error).__name__
        self._retry_at_s, self._presses = now_s + OPEN_AGAIN_S, None
        try:
            self._driver.close()
        except BaseException as second:  # noqa: BLE001 - likewise
            self._fault += f"; closing it failed too: {str(second) or type(second).__name__}"

    def _look(self, now_s: float) -> None:
        is_down = self._driver.is_pressed()
        was_down = self._presses is not None and self._presses.is_down
        if self._presses is None:
            self._presses = Presses(is_down=is_down, now_s=now_s)
        lasted_s = self._presses.look(is_down=is_down, now_s=now_s)
        if OperatorAction(self._table.press) is OperatorAction.STOP_OUTPUTS:
            if self._presses.is_down and not was_down:
                self._commands.append(self._command(0.0))
        elif lasted_s is not None and lasted_s <= STUCK_S:
            self._commands.append(self._command(lasted_s))

    def _command(self, lasted_s: float) -> OperatorCommand:
        table = self._table
        action = OperatorAction(table.hold if table.hold and lasted_s >= table.hold_for else table.press)
        self._count += 1
        return OperatorCommand(
            id=f"button-{self._name}-{self._count}",
            action=action,
            rule=table.rule,
            by=f"button {self._name}",
            for_s=table.shelve_for if action is OperatorAction.SHELVE else None,
        )
