"""A messenger without a broker: it keeps what was sent."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from pydantic import Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.message import Message
from stadimeter.errors import DeviceClosedError
from stadimeter.simulation.world import shared_world


class SimulatedMessengerOptions(DriverOptions):
    """The table of a simulated messenger in the configuration."""

    history: int = Field(default=1000, ge=1)
    """How many delivered messages are kept to look at."""
    queue: int = Field(default=100, ge=1)
    """How many messages of QoS 1 wait while the broker is gone; one more pushes the oldest out."""

    def build(self, context: DriverContext) -> SimulatedMessenger:
        """Return the messenger."""
        return SimulatedMessenger(self, context)


@dataclass(frozen=True, slots=True, kw_only=True)
class SentMessage:
    """A message that was delivered."""

    at_s: float  # when it was delivered, on the run's clock
    message: Message


@dataclass(frozen=True, slots=True)
class _Waiting:
    """A message in the queue, and when it came."""

    since_s: float
    message: Message

    def is_wanted(self, now_s: float) -> bool:
        expires_s = self.message.expires_s
        return expires_s is None or now_s - self.since_s <= expires_s


class SimulatedMessenger:
    """A messenger whose broker is in the simulated world.

    It honours the knob ``broker_gone``. What waits is delivered when the messenger is next used after the broker came
    back: a cycle later in a run.

    Raises:
        ConfigError: The run has no world.
    """

    def __init__(self, options: SimulatedMessengerOptions, context: DriverContext) -> None:
        self.dropped = 0  # how many messages of QoS 0 were lost for want of a broker
        self.given_up = 0  # how many of QoS 1 were given up: pushed out of the queue, or past their time
        self._name = context.name
        self._clock = context.clock
        self._world = shared_world(context)
        self._sent: deque[SentMessage] = deque(maxlen=options.history)
        self._waiting: deque[_Waiting] = deque(maxlen=options.queue)
        self._is_open = False

    @property
    def sent(self) -> tuple[SentMessage, ...]:
        """The messages that were delivered, oldest first. Bounded: the oldest are forgotten."""
        self._deliver()
        return tuple(self._sent)

    def open(self) -> None:
        """Connect if the broker is there. Does nothing when open."""
        self._is_open = True

    def publish(self, message: Message) -> None:
        """Deliver a message, or keep it until the broker is back."""
        if not self._is_open:
            raise DeviceClosedError(f"the simulated messenger '{self._name}' is not open")
        if message.qos == 0 and self._world.faults.broker_gone:
            self.dropped += 1
            return
        self._deliver()
        if len(self._waiting) == self._waiting.maxlen:
            self.given_up += 1
        self._waiting.append(_Waiting(self._clock.now_s(), message))
        self._deliver()

    def undelivered(self) -> tuple[Message, ...]:
        """Return the messages that wait for the broker, oldest first."""
        return tuple(each.message for each in tuple(self._waiting))  # copied first: the loop goes on meanwhile

    def trouble(self) -> str:
        """Return in words what is wrong with the connection, or an empty string if it stands."""
        if not self._is_open:
            return "the simulated messenger is not open"
        if self._world.faults.broker_gone:
            return (
                f"the simulated broker is gone; messages waiting: {len(self._waiting)}, "
                f"given up so far: {self.given_up}"
            )
        self._deliver()
        return ""

    def close(self) -> None:
        """Deliver what waits if the broker is there, and disconnect. May be called any number of times."""
        self._deliver()
        self._is_open = False

    def _deliver(self) -> None:
        if not self._is_open or self._world.faults.broker_gone:
            return
        now_s = self._clock.now_s()
        while self._waiting:
            waiting = self._waiting.popleft()
            if waiting.is_wanted(now_s):
                self._sent.append(SentMessage(at_s=now_s, message=waiting.message))
            else:
                self.given_up += 1
