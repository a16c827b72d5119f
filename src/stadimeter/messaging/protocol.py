"""The interfaces for messages: to other programs, and to people; and how long they wait."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

from msgspec import Struct

from stadimeter.core.message import Message, Notification

if TYPE_CHECKING:
    from stadimeter.core.home_assistant import Announcement, DiscoveryPlace


class Messenger(Protocol):
    """Sends messages to other programs. It never keeps the loop waiting, whatever the network does."""

    @property
    def given_up(self) -> int:
        """Number of messages of QoS 1 given up so far: too many waited, they expired, or they were refused."""

    @property
    def dropped(self) -> int:
        """Number of messages of QoS 0 that were lost so far for want of a connection."""

    def open(self) -> None:
        """Begin to connect and return at once. A broker that is away is not an error: it is tried again."""

    def publish(self, message: Message) -> None:
        """Hand a message over. Returns at once.

        While there is no connection, messages of QoS 1 wait in a bounded queue and messages of QoS 0 are dropped and
        counted.
        """

    def undelivered(self) -> tuple[Message, ...]:
        """Return the messages of QoS 1 that are neither acknowledged nor given up, oldest first.

        May be called from any thread, also after `close`. The next run publishes them again.
        """

    def trouble(self) -> str:
        """Tell what is wrong with the connection, such as ``127.0.0.1:1883 refused the connection``; else ``""``."""

    def close(self) -> None:
        """Say goodbye, wait a moment at most for what is queued, and disconnect. May be called again."""


# Why a message is no request: a broker had kept it; it was sent before this connection, or waited for too long; it has
# more bytes than a request may have.
NoRequest = Literal["retained", "stale", "too_large"]

# What other programs may ask for: nothing; all but what lets outputs act, takes pictures or writes files; everything.
CommandLevel = Literal["off", "alarms", "all"]


class RequestMessage(Struct, frozen=True, kw_only=True):
    """A message on a topic of requests.

    Attributes:
        topic: Below the base topic.
        at_s: When it came, on this computer's monotonic clock.
        refusal: Why it must not be heeded; None if it may be.
        response_topic: Where its sender wants the response, not below the base topic; empty for the usual topic.
        correlation: What the response must carry for its sender; None for nothing.
    """

    topic: str
    payload: bytes
    at_s: float
    refusal: NoRequest | None = None
    response_topic: str = ""
    correlation: bytes | None = None


@runtime_checkable
class TakesRequests(Protocol):
    """A messenger over which other programs may ask for something."""

    @property
    def commands(self) -> CommandLevel:
        """The commands that the configuration allows them to ask for."""

    def listen(
        self, topics: Collection[str], offered: Collection[str], receive: Callable[[RequestMessage], None]
    ) -> None:
        """Receive what comes on exactly these topics, below the base topic. Call it before `open`.

        Args:
            offered: Those of them that are not refused whatever comes; others are answered only.
            receive: It is called in a thread of the messenger, and must neither wait nor fail.
        """

    def respond(self, request: RequestMessage, topic: str, payload: bytes) -> None:
        """Send a response to where its sender wants it, or else to a topic below the base. Returns at once.

        It is dropped while there is no connection: it would come too late.
        """

    def show(self, topic: str, payload: bytes, content_type: str) -> bool:
        """Send bytes, such as a picture, as `respond` does; return whether the connection can take them."""

    def deafness(self) -> str:
        """Return why requests are not received although there is a connection, or an empty string."""


@runtime_checkable
class Discoverable(Protocol):
    """A messenger whose messages a broker keeps beyond the end of a run, and over which Home Assistant discovers it."""

    @property
    def discovery_place(self) -> DiscoveryPlace | None:
        """The place at which it does; None if it shall not."""

    @property
    def orders(self) -> frozenset[str]:
        """The topics, below the base topic, to which others may send. What needs another is not offered."""

    def retain_only(self, topics: frozenset[str]) -> None:
        """Take on which topics messages to keep are published from now on. May be called before `open`.

        What an earlier run left on any other topic is cleared, as soon as there is a connection.
        """

    def announce(self, announcement: Announcement) -> None:
        """Have this discovered from now on, also after Home Assistant began anew. May be called before `open`."""

    def take_states_due(self) -> bool:
        """Return, once each time, whether Home Assistant or the broker began anew, so that it may know no states."""

    def take_forgotten(self) -> bool:
        """Return, once each time, whether the broker has forgotten what it kept of this run, its own messages too."""


@runtime_checkable
class ReachesItsPeer(Protocol):
    """A messenger that can try its connection; a part of its `DriverOptions`."""

    def reach(self) -> str:
        """Connect once, hang up, and return what is wrong, or an empty string. A running instance stays connected."""


class Received(Struct, frozen=True, kw_only=True):
    """A message that a broker passed on.

    Attributes:
        topic: The whole topic, as the sender wrote it.
        payload: At most a few kilobytes; of a longer one the beginning.
        is_retained: Whether the broker had kept it from before the subscription.
        expires_s: What is left of its life; None for ever, or where it is not known.
    """

    topic: str
    payload: bytes
    is_retained: bool = False
    expires_s: int | None = None


class Subscription(Protocol):
    """A connection that listens. Its user serves it, in one thread. It connects again after a loss."""

    def trouble(self) -> str:
        """Describe what is wrong with the connection; empty while the peer passes messages on."""

    def serve(self, wait_s: float) -> None:
        """Connect if it is time to, and hand over what arrives, for that long at most. Connecting may take longer."""

    def publish(self, topic: str, payload: str, expires_s: int | None) -> None:
        """Send a message with QoS 1. The peer keeps one that does not expire. Only while there is no trouble."""

    def close(self) -> None:
        """Disconnect for good."""


@runtime_checkable
class Subscribes(Protocol):
    """A messenger through which other devices can be listened to; a part of its `DriverOptions`."""

    @property
    def base(self) -> str:
        """The beginning of the topics of this device."""

    @property
    def place(self) -> str:
        """The peer, for messages to people; and how long they wait."""

    def subscribe(self, filters: Sequence[str], take: Callable[[Received], None]) -> Subscription:
        """Return a subscription, not connected yet.

        Args:
            filters: The topics, with the wildcards of MQTT. They must not overlap.
            take: Takes each message, within `Subscription.serve`.
        """


class Notifier(Protocol):
    """Sends notifications to people. It never keeps the loop waiting, whatever the service behind it does."""

    @property
    def given_up(self) -> int:
        """Number of notifications that were given up so far: they were not taken in time, or too many waited."""

    def open(self) -> None:
        """Get ready and return at once. A service that is away is not an error: it is tried when there is something.

        Raises:
            DriverError: It can never work: a library, a file or its address is wrong.
        """

    def notify(self, notification: Notification) -> None:
        """Hand a notification over. Returns at once.

        Notifications wait in a bounded queue until the service has taken them. One that cannot be delivered is tried
        again for a while, and then given up and counted.
        """

    def undelivered(self) -> tuple[Notification, ...]:
        """Return the notifications that were neither taken nor given up, oldest first.

        May be called from any thread, also after `close`. The next run sends them again.
        """

    def trouble(self) -> str:
        """Describe what is wrong in one line, without the service's address, which is mostly a secret; else ``""``."""

    def close(self) -> None:
        """Wait a moment at most for what is on its way, and let go. What is left over is `undelivered`."""


# Time-outs, and the growing pauses between attempts.


class Patience(Struct, frozen=True, kw_only=True):
    """The time-outs and pauses of a connection.

    Attributes:
        answer_s: For a broker's answer to a connection. Some brokers that do not know MQTT 5 never answer it.
        first_pause_s: After the first attempt that failed.
        longest_pause_s: The pauses double up to this.
        alarm_pause_s: No pause is longer while something waits that must arrive: an alarm, or a notification.
        goodbye_s: For what is on its way when we close, and as long again for the thread to end.
    """

    answer_s: float = 5.0
    first_pause_s: float = 1.0
    longest_pause_s: float = 60.0
    alarm_pause_s: float = 10.0
    goodbye_s: float = 0.3


class BackOff:
    """Pauses that double from the first to the longest."""

    def __init__(self, patience: Patience) -> None:
        self._first_s = patience.first_pause_s
        self._longest_s = patience.longest_pause_s
        self._next_s = self._first_s

    def next_s(self) -> float:
        """Return the next pause in seconds."""
        pause_s = self._next_s
        self._next_s = min(self._longest_s, pause_s * 2)
        return pause_s

    def reset(self) -> None:
        """Begin with the first pause again."""
        self._next_s = self._first_s

    def jump_to_longest(self) -> None:
        """Let the next pause be the longest."""
        self._next_s = self._longest_s
