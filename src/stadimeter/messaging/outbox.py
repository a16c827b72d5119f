"""Messages that wait for a broker."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from itertools import count

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.decision import Severity, first_to_go
from stadimeter.core.message import KEPT_S, NEWS_S, Message, as_history


class DirectMessage(Message, frozen=True, kw_only=True):
    """A response, or a picture that was asked for. Its topic is absolute, and its QoS 0.

    Attributes:
        content: It takes the place of the payload.
        correlation: What a response carries for who asked; None for nothing.
    """

    content: bytes
    content_type: str
    correlation: bytes | None = None
    payload: str = ""
    is_absolute: bool = True


class PendingMessage(Struct, frozen=True):
    """A message, since when it waits or is on the wire, and when it is of no use any more."""

    message: Message
    since_s: float
    deadline_s: float

    def on_wire(self, now_s: float) -> Message:
        """Return it as it is sent now: with what is left of its life, and an event that waited as history."""
        message = as_history(self.message) if now_s - self.since_s > NEWS_S else self.message
        if message.expires_s is None:
            return message
        return replace(message, expires_s=math.ceil(self.deadline_s - now_s))


def pending(message: Message, now_s: float) -> PendingMessage:
    """Return a message that waits from now on. All times are on one monotonic clock."""
    lives_s: float = KEPT_S if message.expires_s is None else message.expires_s
    is_for_good = message.expires_s is None and (message.retain or message.severity is Severity.SAFETY)
    return PendingMessage(message, now_s, math.inf if is_for_good else now_s + lives_s)


# Stands for the number of a message that was taken and has none yet; paho's begin with 1.
_TAKEN = -1


class MemoryOutbox:
    """Remembers messages of QoS 1 until a broker has acknowledged them, and those of QoS 0 until they are written.

    They go in the order in which they came, save that those of QoS 0 do not wait for acknowledgements.

    It does no I/O and knows no clock. A full outbox gives up, for a new message, a state that a newer one has replaced,
    or else the oldest of what matters least. It keeps what is about safety, and each topic's newest message that the
    broker is to keep, even beyond its capacity. Nothing survives the end of the program by itself; see `undelivered`.

    Args:
        capacity: How many messages of QoS 1 may wait.
        window: How many of QoS 1 may be on the wire at a time. Brokers allow 20 where they say nothing else.
        unwritten_max: How many of QoS 0 may wait for the operating system to take them.

    Attributes:
        dropped: How many messages of QoS 0 were not written, and how many states of QoS 1 were replaced unsent.
        given_up: How many other messages of QoS 1 were given up: too many waited, they expired, or were refused.
    """

    def __init__(self, *, capacity: int = 10_000, window: int = 20, unwritten_max: int = 100) -> None:
        self.dropped = 0
        self.given_up = 0
        self._capacity = capacity
        self._window = window
        self._unwritten_max = unwritten_max
        self._numbers = count()
        self._waiting: OrderedDict[int, PendingMessage] = OrderedDict()
        self._unacknowledged: dict[int, PendingMessage] = {}
        self._unkept: deque[tuple[int, PendingMessage]] = deque()
        self._unwritten: set[int] = set()

    @property
    def is_empty(self) -> bool:
        """True if nothing waits and nothing is on the wire."""
        return not (self._waiting or self._unacknowledged or self._unkept or self._unwritten)

    @property
    def has_room_on_wire(self) -> bool:
        """True if a message of QoS 0 may be sent; if not, the link is slower than what is said over it."""
        return len(self._unkept) + len(self._unwritten) < self._unwritten_max

    def add(self, message: Message, now_s: float) -> None:
        """Let a message wait for its turn; one of QoS 0 is dropped and counted if there is no room on the wire."""
        if message.qos == 0:
            if self.has_room_on_wire:
                self._unkept.append((next(self._numbers), pending(message, now_s)))
            else:
                self.drop()
            return
        if len(self._waiting) >= self._capacity:
            self._make_room()
        self._waiting[next(self._numbers)] = pending(message, now_s)

    def take(self, now_s: float) -> PendingMessage | None:
        """Return the next message that may be sent now; then report it to `sent`. Until then it is undelivered.

        None if none waits that has not expired, or enough are on the wire.
        """
        while True:
            next_kept = next(iter(self._waiting), None) if len(self._unacknowledged) < self._window else None
            if self._unkept and (next_kept is None or self._unkept[0][0] < next_kept):
                found = self._unkept.popleft()[1]
                if now_s < found.deadline_s:
                    return found
                self.drop()
            elif next_kept is not None:
                found = self._waiting.pop(next_kept)
                if now_s < found.deadline_s:
                    self._unacknowledged[_TAKEN] = found
                    return found
                self.given_up += 1
            else:
                return None

    def refuse_taken(self, taken: PendingMessage) -> None:
        """Give up what was taken and can never be sent."""
        if taken.message.qos == 0:
            self.drop()
        self.done(_TAKEN, is_refused=True)

    def sent(self, number: int, sent: PendingMessage) -> None:
        """Note that a message is on the wire."""
        self._unacknowledged.pop(_TAKEN, None)
        if sent.message.qos == 0:
            self._unwritten.add(number)
        else:
            self._unacknowledged[number] = sent

    def done(self, number: int, *, is_refused: bool = False) -> None:
        """Note that a message was written (QoS 0) or answered (QoS 1); unknown numbers are passed over."""
        self._unwritten.discard(number)
        if self._unacknowledged.pop(number, None) is not None and is_refused:
            self.given_up += 1

    def drop(self) -> None:
        """Count a message that could not be sent."""
        self.dropped += 1

    def start_over(self) -> None:
        """Take messages back from a wire that is no more, to send them again on another, in the same order.

        Those of QoS 0 that were not written are dropped.
        """
        self.dropped += len(self._unwritten) + len(self._unkept)
        self._unwritten.clear()
        self._unkept.clear()
        if not self._unacknowledged:
            return
        again = (*self._unacknowledged.values(), *self._waiting.values())
        self._unacknowledged.clear()
        self._waiting.clear()
        self._waiting.update((next(self._numbers), each) for each in again)

    def undelivered(self) -> tuple[Message, ...]:
        """Return the messages of QoS 1 that are neither acknowledged nor given up, oldest first."""
        return tuple([each.message for each in (*self._unacknowledged.values(), *self._waiting.values())])

    def _make_room(self) -> None:
        waiting = [(number, each.message) for number, each in self._waiting.items()]
        newest = {message.topic: number for number, message in waiting}
        replaced = [number for number, message in waiting if message.retain and newest[message.topic] != number]
        if replaced:
            del self._waiting[replaced[0]]
            self.dropped += 1
            return
        passing = [(number, message.severity) for number, message in waiting if not message.retain]
        if (last := first_to_go(severity for _, severity in passing)) is not None:
            del self._waiting[passing[last][0]]
            self.given_up += 1
