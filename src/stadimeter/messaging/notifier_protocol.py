"""What a notifier is to the rest of the program."""

from __future__ import annotations

from typing import Protocol

from stadimeter.core.notification import Notification


class Notifier(Protocol):
    """Tells people. It never keeps the loop waiting, whatever the service behind it does."""

    @property
    def given_up(self) -> int:
        """How many notifications were given up so far: they were not taken in time, or too many waited."""
        ...

    def open(self) -> None:
        """Get ready and return at once. A service that is away is not an error: it is tried when there is something.

        Raises:
            DriverError: It can never work: a library, a file or its address is wrong.
        """
        ...

    def notify(self, notification: Notification) -> None:
        """Hand a notification over. Returns at once.

        Notifications wait in a bounded queue until the service has taken them. One that cannot be delivered is tried
        again for a while, and then given up and counted.
        """
        ...

    def undelivered(self) -> tuple[Notification, ...]:
        """Return the notifications that were neither taken nor given up, oldest first.

        After `close`, those that were left over; they are sent if it is opened again. It may be called from any thread,
        and a run keeps them in its state file: `notify` in the next run sends them again.
        """
        ...

    def trouble(self) -> str:
        """Return in words what is wrong, or an empty string if everything was delivered so far.

        Returns:
            One line, without the service's address: that is a secret more often than not.
        """
        ...

    def close(self) -> None:
        """Wait a moment at most for what is on its way, and let go. What is left over is `undelivered`."""
        ...
