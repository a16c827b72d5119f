"""Messages that wait for a broker."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from stadimeter.core.message import Message


@dataclass(frozen=True, slots=True)
class _PendingMessage:
    """A message, and when it expires."""

    message: Message
    deadline_s: float


class MemoryOutbox:
    """Remembers messages of QoS 1 until a broker has acknowledged them, and those of QoS 0 until they are written.

    It does no I/O and knows no clock. A full outbox gives up a state that a newer one has replaced, or else its oldest
    message, for a new one. Nothing survives the end of the program by itself; see `undelivered`.

    Args:
        capacity: How many messages of QoS 1 may wait.
        window: How many of QoS 1 may be on the wire at a time. Brokers allow 20 where they say nothing else.
        unwritten_max: How many of QoS 0 may wait for the operating system to take them.

    Attributes:
        dropped: How many messages of QoS 0 were not written, and how many states of QoS 1 were replaced unsent.
        given_up: How many other messages of QoS 1 were given up: too many waited, they expired, or were refused.
    """

    def __init__(self, *, capacity: int = 1000, window: int = 20, unwritten_max: int = 100) -> None:
        self.dropped = 0
        self.given_up = 0
        self._capacity = capacity
        self._window = window
        self._unwritten_max = unwritten_max
        self._waiting: deque[_PendingMessage] = deque()
        self._unacknowledged: dict[int, _PendingMessage] = {}
        self._unwritten: set[int] = set()

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits and nothing is on the wire."""
        return not (self._waiting or self._unacknowledged or self._unwritten)

    @property
    def has_room_on_wire(self) -> bool:
        """Whether a message of QoS 0 may be sent; if not, the link is slower than what is said over it."""
        return len(self._unwritten) < self._unwritten_max

    def add(self, message: Message, now_s: float) -> None:
        """Let a message of QoS 1 wait for its turn. All times are on one monotonic clock."""
        if len(self._waiting) >= self._capacity:
            self._make_room()
        lives_s = math.inf if message.expires_s is None else message.expires_s
        self._waiting.append(_PendingMessage(message, now_s + lives_s))

    def take(self, now_s: float) -> Message | None:
        """Return the next message that may be sent now, with what is left of its life; then report it to `sent`.

        None if none waits that has not expired, or enough are on the wire.
        """
        while self._waiting and len(self._unacknowledged) < self._window:
            waiting = self._waiting.popleft()
            left_s = waiting.deadline_s - now_s
            if left_s == math.inf:
                return waiting.message
            if left_s > 0:
                return replace(waiting.message, expires_s=math.ceil(left_s))
            self.given_up += 1
        return None

    def sent(self, number: int, message: Message, now_s: float) -> None:
        """Note that a message is on the wire."""
        if message.qos == 0:
            self._unwritten.add(number)
        else:
            lives_s = math.inf if message.expires_s is None else message.expires_s
            self._unacknowledged[number] = _PendingMessage(message, now_s + lives_s)

    def done(self, number: int, *, is_refused: bool = False) -> None:
        """Note that a message was written (QoS 0) or answered (QoS 1); unknown numbers are passed over."""
        self._unwritten.discard(number)
        if self._unacknowledged.pop(number, None) is not None and is_refused:
            self.given_up += 1

    def drop(self) -> None:
        """Count a message that could not be sent."""
        self.dropped += 1

    def connection_lost(self) -> None:
        """Give up the messages of QoS 0 that were not written; paho keeps those of QoS 1 and sends them again."""
        self.dropped += len(self._unwritten)
        self._unwritten.clear()

    def start_over(self) -> None:
        """Take every message back from a wire that is no more, to send it again on another, in the same order."""
        self.connection_lost()
        self._waiting.extendleft(reversed(self._unacknowledged.values()))
        self._unacknowledged.clear()

    def undelivered(self) -> tuple[Message, ...]:
        """Return the messages of QoS 1 that are neither acknowledged nor given up, oldest first."""
        return tuple(each.message for each in (*self._unacknowledged.values(), *self._waiting))

    def _make_room(self) -> None:
        """Drop the oldest state that a newer one has replaced; if there is none, give up the oldest message."""
        newest = {each.message.topic: each for each in self._waiting}
        for each in self._waiting:
            if each.message.retain and newest[each.message.topic] is not each:
                self._waiting.remove(each)
                self.dropped += 1
                return
        self._waiting.popleft()
        self.given_up += 1
