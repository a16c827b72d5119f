"""A messenger without a broker and a notifier without a service: what was sent is kept."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from typing import ClassVar, Generic, TypeVar

from msgspec import Struct

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.decision import first_to_go
from stadimeter.core.message import Message, Notification
from stadimeter.errors import DeviceClosedError
from stadimeter.simulation.world import shared_world

ItemT = TypeVar("ItemT", Message, Notification)


# How many items that must arrive wait while the other side is gone; one more pushes out what matters least.
QUEUE_MAX = 100

# How many delivered items are kept to look at.
SENT_MAX = 10_000


class Sent(Struct, Generic[ItemT], frozen=True, kw_only=True):
    """A message or a notification that was delivered."""

    at_s: float  # when it was delivered, on the run's clock
    item: ItemT


class Outbox(Generic[ItemT]):
    """The items delivered, and those waiting for the other side: delivered at the next use after that is back.

    Attributes:
        given_up: How many were pushed out of the queue.
    """

    GONE: ClassVar[str]

    def __init__(self, context: DriverContext, kind: str) -> None:
        self.given_up = 0
        self._name = f"the simulated {kind} '{context.name}'"
        self._clock = context.clock
        self._sent: deque[Sent[ItemT]] = deque(maxlen=SENT_MAX)
        self._waiting: deque[ItemT] = deque()
        self._is_open = False

    @abstractmethod
    def is_away(self) -> bool:
        """Check whether the other side is away now."""

    @property
    def sent(self) -> tuple[Sent[ItemT], ...]:
        """The items delivered, oldest first. Bounded: the oldest is forgotten."""
        self._deliver()
        return tuple(self._sent)

    def open(self) -> None:
        """Connect if the other side is there. Does nothing when open."""
        self._is_open = True

    def undelivered(self) -> tuple[ItemT, ...]:
        """List what waits for the other side, oldest first."""
        return tuple(self._waiting)

    def trouble(self) -> str:
        """Return in words what is wrong with the connection, or an empty string if it stands."""
        if not self._is_open:
            return f"{self._name} is not open"
        if self.is_away():
            return f"{self.GONE}; waiting: {len(self._waiting)}, given up so far: {self.given_up}"
        self._deliver()
        return ""

    def close(self) -> None:
        """Deliver what waits if the other side is there, and disconnect. May be called any number of times."""
        self._deliver()
        self._is_open = False

    def _check_open(self) -> None:
        if not self._is_open:
            raise DeviceClosedError(f"{self._name} is not open")

    def _put(self, item: ItemT) -> None:
        self._deliver()
        last = first_to_go(item.severity for item in self._waiting) if len(self._waiting) >= QUEUE_MAX else None
        if last is not None:
            del self._waiting[last]
            self.given_up += 1
        self._waiting.append(item)
        self._deliver()

    def _deliver(self) -> None:
        if not self._is_open or self.is_away():
            return
        while self._waiting:
            self._sent.append(Sent(at_s=self._clock.now_s(), item=self._waiting.popleft()))


class SimulatedMessengerOptions(DriverOptions):
    """The options of a simulated messenger: none."""

    def build(self, context: DriverContext) -> SimulatedMessenger:
        """Return the messenger."""
        return SimulatedMessenger(context)


class SimulatedMessenger(Outbox[Message]):
    """A messenger whose broker is in the simulated world. It honours the knob ``broker_gone``.

    Raises:
        ConfigError: The run has no world.
    """

    GONE = "the simulated broker is gone"

    def __init__(self, context: DriverContext) -> None:
        super().__init__(context, "messenger")
        self.dropped = 0  # how many messages of QoS 0 were lost for want of a broker
        self._world = shared_world(context)

    def is_away(self) -> bool:
        """Check whether the broker is gone."""
        return self._world.faults.broker_gone

    def publish(self, message: Message) -> None:
        """Deliver a message, or keep it until the broker is back."""
        self._check_open()
        if message.qos == 0 and self.is_away():
            self.dropped += 1
        else:
            self._put(message)


# A notifier without a service: it keeps what was sent ---------------------------------------------


class SimulatedNotifierOptions(DriverOptions):
    """The options of a simulated notifier: none."""

    def build(self, context: DriverContext) -> SimulatedNotifier:
        """Return the notifier."""
        return SimulatedNotifier(context)


class SimulatedNotifier(Outbox[Notification]):
    """A notifier that needs no service, and no world either.

    Attributes:
        is_gone: The knob: the service is away.
    """

    GONE = "the simulated service is gone"

    def __init__(self, context: DriverContext) -> None:
        super().__init__(context, "notifier")
        self.is_gone = False

    def is_away(self) -> bool:
        """Check whether the service is away."""
        return self.is_gone

    def notify(self, notification: Notification) -> None:
        """Deliver a notification, or keep it until the service is back."""
        self._check_open()
        self._put(notification)
