"""A notifier without a service: it keeps what was sent."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from pydantic import Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.notification import Notification
from stadimeter.errors import DeviceClosedError


class SimulatedNotifierOptions(DriverOptions):
    """The table of a simulated notifier in the configuration."""

    history: int = Field(default=1000, ge=1)
    """How many delivered notifications are kept to look at."""
    queue: int = Field(default=100, ge=1)
    """How many wait while the service is gone; one more pushes the oldest out."""

    def build(self, context: DriverContext) -> SimulatedNotifier:
        """Return the notifier."""
        return SimulatedNotifier(self, context)


@dataclass(frozen=True, slots=True, kw_only=True)
class SentNotification:
    """A notification that was delivered."""

    at_s: float  # when it was delivered, on the run's clock
    notification: Notification


class SimulatedNotifier:
    """A notifier that needs no service, and no world either. What waits is delivered when it is next used."""

    def __init__(self, options: SimulatedNotifierOptions, context: DriverContext) -> None:
        self.is_gone = False  # the knob: the service is away
        self.given_up = 0  # how many notifications were pushed out of the queue
        self._name = context.name
        self._clock = context.clock
        self._queue = options.queue
        self._sent: deque[SentNotification] = deque(maxlen=options.history)
        self._waiting: deque[Notification] = deque()
        self._is_open = False

    @property
    def sent(self) -> tuple[SentNotification, ...]:
        """The notifications that were delivered, oldest first. Bounded: the oldest are forgotten."""
        self._deliver()
        return tuple(self._sent)

    def open(self) -> None:
        """Get ready. Does nothing when open."""
        self._is_open = True

    def notify(self, notification: Notification) -> None:
        """Deliver a notification, or keep it until the service is back."""
        if not self._is_open:
            raise DeviceClosedError(f"the simulated notifier '{self._name}' is not open")
        if len(self._waiting) >= self._queue:
            self._waiting.popleft()
            self.given_up += 1
        self._waiting.append(notification)
        self._deliver()

    def undelivered(self) -> tuple[Notification, ...]:
        """Return the notifications that wait for the service, oldest first."""
        return tuple(self._waiting)

    def trouble(self) -> str:
        """Return in words what is wrong, or an empty string if everything was delivered so far."""
        if not self._is_open:
            return f"the simulated notifier '{self._name}' is not open"
        self._deliver()
        if not self._waiting:
            return ""
        return (
            f"the simulated notifier '{self._name}': its service is gone; waiting: {len(self._waiting)}, "
            f"given up so far: {self.given_up}"
        )

    def close(self) -> None:
        """Deliver what waits if the service is there. May be called any number of times."""
        self._deliver()
        self._is_open = False

    def _deliver(self) -> None:
        if not self._is_open or self.is_gone:
            return
        while self._waiting:
            self._sent.append(SentNotification(at_s=self._clock.now_s(), notification=self._waiting.popleft()))
