"""The interfaces for messages: to other programs, and to people."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from stadimeter.core.message import Message
from stadimeter.core.notification import Notification


class Messenger(Protocol):
    """Sends messages to other programs. It never keeps the loop waiting, whatever the network does."""

    @property
    def given_up(self) -> int:
        """Number of messages of QoS 1 given up so far: too many waited, they expired, or they were refused."""

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
        """Return what is wrong with the connection, such as ``127.0.0.1:1883 refused the connection``; else ``""``."""

    def close(self) -> None:
        """Say goodbye, wait a moment at most for what is queued, and disconnect. May be called again."""


@runtime_checkable
class Retaining(Protocol):
    """A messenger whose messages are kept elsewhere, beyond the end of a run."""

    def retain_only(self, topics: frozenset[str]) -> None:
        """Take on which topics messages to keep are published from now on. May be called before `open`.

        What an earlier run left on any other topic is cleared, as soon as there is a connection.
        """


@runtime_checkable
class ReachesItsPeer(Protocol):
    """A messenger that can try its connection; a part of its `DriverOptions`."""

    def reach(self) -> str:
        """Connect once, hang up, and return what is wrong, or an empty string. A running instance stays connected."""


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
        """Return what is wrong in one line, without the service's address, which is mostly a secret; else ``""``."""

    def close(self) -> None:
        """Wait a moment at most for what is on its way, and let go. What is left over is `undelivered`."""
