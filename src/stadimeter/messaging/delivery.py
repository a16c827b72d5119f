"""Notifications on their way to a service that may be slow or away: a thread of their own, and a bounded queue."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from stadimeter.core.notification import Notification
from stadimeter.messaging.back_off import BackOff, Patience

QUEUE_MAX = 100
"""More than this do not wait: then the oldest is given up for the newest."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A notification, and until when it is tried."""

    notification: Notification
    until_s: float


class Delivery:
    """Delivers notifications one after the other, in order, and tries again what failed.

    Args:
        deliver: Hands one notification to the service; returns why it could not, or an empty string. It may take its
            time, and is always called in the delivery's own thread.
        retry_s: For how long one notification is tried.
        patience: The pauses between two attempts, and how long to wait at the end.

    Attributes:
        delivered: How many notifications the service has taken.
        given_up: How many it will not be asked again, since it did not take them in time or too many waited.
    """

    def __init__(self, deliver: Callable[[Notification], str], retry_s: float, patience: Patience) -> None:
        self.delivered = 0
        self.given_up = 0
        self._deliver = deliver
        self._retry_s = retry_s
        self._patience = patience
        self._pauses = BackOff(patience)
        self._waiting: deque[_Waiting] = deque()
        self._trying: _Waiting | None = None
        self._left: list[_Waiting] = []
        self._changed = threading.Condition()
        self._is_stopping = False
        self._reason = ""
        self._pause_s = 0.0
        self._thread = threading.Thread(target=self._work, name="notifications", daemon=True)

    def start(self) -> None:
        """Begin to deliver."""
        self._thread.start()

    def add(self, notification: Notification) -> None:
        """Let a notification wait for its turn. Returns at once."""
        with self._changed:
            if len(self._waiting) >= QUEUE_MAX:
                self._waiting.popleft()
                self._give_up(self._reason or "too many were waiting")
            self._waiting.append(_Waiting(notification, time.monotonic() + self._retry_s))
            self._changed.notify()

    def trouble(self) -> str:
        """Return what is wrong, in words without line breaks; empty if the newest attempt succeeded."""
        with self._changed:
            if not self._reason:
                return ""
            given_up = f"; given up so far: {self.given_up}" if self.given_up else ""
            if not self._waiting:
                return f"{self._reason}{given_up}"
            return f"{self._reason}; trying again in {self._pause_s:g} s; waiting: {len(self._waiting)}{given_up}"

    def stop(self) -> None:
        """Give what waits one last chance, for a moment. What is left over is `undelivered`."""
        with self._changed:
            self._is_stopping = True
            self._changed.notify()
        self._thread.join(self._patience.goodbye_s)

    def undelivered(self) -> tuple[Notification, ...]:
        """Return the notifications that were neither taken nor given up, oldest first."""
        with self._changed:
            trying = [self._trying] if self._trying else []
            return tuple(each.notification for each in (*self._left, *trying, *self._waiting))

    def _give_up(self, reason: str) -> None:
        self.given_up += 1
        self._reason = reason

    def _work(self) -> None:
        while (trying := self._next()) is not None:
            reason = self._deliver(trying.notification)
            with self._changed:
                self._note(trying, reason)

    def _next(self) -> _Waiting | None:
        """Wait until there is something to deliver; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_stopping)
            self._trying = self._waiting.popleft() if self._waiting else None
            return self._trying

    def _note(self, tried: _Waiting, reason: str) -> None:
        """Take in what became of an attempt, and pause after one that failed."""
        self._trying = None
        if not reason:
            self.delivered += 1
            self._reason = ""
            self._pauses.reset()
        elif time.monotonic() >= tried.until_s:
            self._give_up(reason)
        elif self._is_stopping:
            self._left.append(tried)
        else:
            self._reason = reason
            self._waiting.appendleft(tried)
            self._pause_s = min(self._pauses.next_s(), self._patience.alarm_pause_s)
            self._changed.wait_for(lambda: self._is_stopping, self._pauses.spread_s(self._pause_s))
