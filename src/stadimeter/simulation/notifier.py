"""A notifier without a service: it keeps what was sent."""

from __future__ import annotations

from stadimeter.config.plugins import DriverContext
from stadimeter.core.message import Notification
from stadimeter.simulation.messenger import Outbox, OutboxOptions


class SimulatedNotifierOptions(OutboxOptions):
    """The table of a simulated notifier in the configuration."""

    def build(self, context: DriverContext) -> SimulatedNotifier:
        """Return the notifier."""
        return SimulatedNotifier(self, context)


class SimulatedNotifier(Outbox[Notification]):
    """A notifier that needs no service, and no world either.

    Attributes:
        is_gone: The knob: the service is away.
    """

    GONE = "the simulated service is gone"

    def __init__(self, options: SimulatedNotifierOptions, context: DriverContext) -> None:
        super().__init__(options, context, "notifier")
        self.is_gone = False

    def is_away(self) -> bool:
        """Check whether the service is away."""
        return self.is_gone

    def notify(self, notification: Notification) -> None:
        """Deliver a notification, or keep it until the service is back."""
        self._check_open()
        self._put(notification)
