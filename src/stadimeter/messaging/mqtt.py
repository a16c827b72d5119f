"""The messenger that speaks MQTT, through paho."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

from paho.mqtt.client import Client
from paho.mqtt.enums import MQTTProtocolVersion

from stadimeter.config.plugins import DriverContext
from stadimeter.core.home_assistant import Announcement, DiscoveryPlace
from stadimeter.core.message import REQUEST, Message
from stadimeter.errors import ConfigError, DeviceClosedError, DeviceOpenError
from stadimeter.messaging.back_off import Patience
from stadimeter.messaging.broker_link import V5, V311, BrokerLink, serve
from stadimeter.messaging.broker_secrets import read_secrets
from stadimeter.messaging.link_events import LinkEvents
from stadimeter.messaging.mqtt_client import MqttSettings, make_client, say_goodbye, subscribe
from stadimeter.messaging.protocol import CommandLevel, Received, RequestMessage
from stadimeter.messaging.request_topics import RequestTopics, describe_deafness
from stadimeter.operator_actions import OperatorAction

if TYPE_CHECKING:
    from stadimeter.messaging.subscription import MqttSubscription

ASKED_S = 3.0

_NOT_IN_TOPICS = frozenset("+#\0")


class MqttOptions(MqttSettings):
    """The table of an ``mqtt`` messenger.

    The password is never part of a configuration: configurations are shown, logged and shared. It stands in a file of
    its own, which may be a systemd credential.
    """

    def build(self, context: DriverContext) -> PahoMessenger:  # noqa: ARG002 - the interface of every driver
        """Return the messenger."""
        return PahoMessenger(self)

    def subscribe(
        self, filters: Sequence[str], take: Callable[[Received], None], max_bytes: int | None = None
    ) -> MqttSubscription:
        """Return a subscription, not connected yet; see `stadimeter.messaging.protocol.Subscribes`."""
        from stadimeter.messaging.subscription import MqttSubscription  # noqa: PLC0415 - no run needs it

        return MqttSubscription(self, filters, take, packet_max=max_bytes)

    def reach(self) -> str:
        """Connect once with this login, hang up, and return what is wrong, or an empty string.

        It has a client id of its own, for a broker would throw out a running instance of the same id, and no last will.
        """
        asking = self.model_copy(update={"node": f"{self.node}-doctor"})
        try:
            secrets = read_secrets(asking)
        except DeviceOpenError as error:
            return str(error)
        events, trouble = LinkEvents(asking), ""
        for version in {"5": (V5,), "3.1.1": (V311,)}.get(self.protocol, (V5, V311)):
            events.begin()
            client = make_client(asking, secrets, version, ASKED_S)
            client.will_clear()
            events.listen_to(client)
            trouble = _attempt(client, version, events, self)
            if events.is_accepted or not events.suspects_version:
                break
        if not events.is_accepted:
            return events.ending
        return trouble


def _attempt(client: Client, version: MQTTProtocolVersion, events: LinkEvents, options: MqttSettings) -> str:
    """Connect and hang up; return what is wrong with a connection that the broker accepted."""
    trouble = ""
    try:
        client.reconnect()
    except OSError as error:
        events.note_connect_error(error)
        return trouble
    until_s = time.monotonic() + ASKED_S
    while not events.is_accepted and (left_s := until_s - time.monotonic()) > 0 and serve(client.loop, events, left_s):
        pass
    if events.is_accepted:
        trouble = _try_to_listen(client, version, events, options) if options.commands != "off" else ""
        say_goodbye(client, version)
        serve(client.loop, events, 0.0)
    elif not events.ending:
        events.note_no_answer()
    if (connection := client.socket()) is not None:
        connection.close()
    return trouble


def _try_to_listen(client: Client, version: MQTTProtocolVersion, events: LinkEvents, options: MqttSettings) -> str:
    """Subscribe to one topic of requests; return why the broker does not let us, or an empty string."""
    topic = f"{options.base}/{REQUEST.of(OperatorAction.STOP_OUTPUTS)}"
    subscribe(client, [topic], 1 if version == V5 and events.has_identifiers else None)
    until_s = time.monotonic() + ASKED_S
    while (left_s := until_s - time.monotonic()) > 0 and serve(client.loop, events, left_s):
        for _, codes in events.take_subscribed():
            refused = [str(code) for code in codes if code.is_failure]
            return describe_deafness(options, [topic], refused[0]) if refused else ""
    return events.ending


class PahoMessenger:
    """Publishes to an MQTT broker.

    A thread of its own does all that can wait for the network. Messages of QoS 1 wait in memory while there is no
    connection. What is left when it is closed is sent when it is opened again.

    Attributes:
        orders: The topics below the base topic to which others may send; see `Discoverable`.
    """

    def __init__(self, options: MqttOptions, patience: Patience = Patience()) -> None:  # noqa: B008 - it is frozen
        self._options = options
        self._patience = patience
        self._link: BrokerLink | None = None
        self._left: tuple[Message, ...] = ()
        self._retained: frozenset[str] | None = None
        self._requests: RequestTopics | None = None
        self.orders: frozenset[str] = frozenset()
        self._announcement: Announcement | None = None
        self._dropped_before = 0
        self._given_up_before = 0

    @property
    def dropped(self) -> int:
        """Number of messages of QoS 0 that were lost for want of a connection, and states of QoS 1 replaced unsent."""
        return self._dropped_before + (self._link.queue.dropped if self._link else 0)

    @property
    def given_up(self) -> int:
        """Number of messages of QoS 1 that were given up: too many waited, they expired, or the broker refused them."""
        return self._given_up_before + (self._link.queue.given_up if self._link else 0)

    @property
    def commands(self) -> CommandLevel:
        """The commands that other programs may ask for."""
        return self._options.commands

    def undelivered(self) -> tuple[Message, ...]:
        """Return the messages of QoS 1 that are neither acknowledged nor given up, oldest first."""
        link = self._link
        return link.queue.undelivered() if link is not None else self._left

    def open(self) -> None:
        """Begin to connect and return at once. A broker that is away is not an error."""
        if self._link is not None:
            return
        self._link = BrokerLink(self._options, read_secrets(self._options), self._patience, self._requests)
        self._link.retained.announce(self._announcement)
        if self._retained is not None:
            self._link.retained.retain_only(self._retained)
        left, self._left = self._left, ()
        for message in left:
            self._link.queue.send(message)
        self._link.start()

    def publish(self, message: Message) -> None:
        """Hand a message over and return at once.

        Raises:
            ConfigError: Its topic cannot be one.
        """
        if not message.topic or not _NOT_IN_TOPICS.isdisjoint(message.topic):
            raise ConfigError(f"{message.topic!r} is not a topic to publish to; rename what it is made from")
        if self._link is None:
            raise DeviceClosedError(f"the messenger for {self._options.place} is not open; open it first")
        self._link.queue.send(message)

    def retain_only(self, topics: frozenset[str]) -> None:
        """Have the broker forget what an earlier run left on other topics; see `Retaining`."""
        self._retained = topics
        if self._link is not None:
            self._link.retained.retain_only(topics)

    def listen(
        self, topics: Collection[str], offered: Collection[str], receive: Callable[[RequestMessage], None]
    ) -> None:
        """Receive what comes on topics of requests; see `TakesRequests`."""
        self.orders = frozenset(offered)
        self._requests = RequestTopics(self._options, topics, receive)

    def respond(self, request: RequestMessage, topic: str, payload: bytes) -> None:
        """Answer a request; see `TakesRequests`."""
        if (link := self._link) is not None:
            place = request.response_topic or f"{self._options.base}/{topic}"
            link.send_now(place, payload, "application/json", request.correlation)

    def show(self, topic: str, payload: bytes, content_type: str) -> bool:
        """Send a picture; return whether it can be sent."""
        link = self._link
        return link is not None and link.send_now(f"{self._options.base}/{topic}", payload, content_type)

    def deafness(self) -> str:
        """Return why requests are not received although there is a connection."""
        link = self._link
        return link.deafness() if link is not None else ""

    @property
    def discovery_place(self) -> DiscoveryPlace | None:
        """The place at which Home Assistant discovers this node; see `Discoverable`."""
        return self._options.discovery_place

    def announce(self, announcement: Announcement) -> None:
        """Have Home Assistant discover this, over every connection; see `Discoverable`."""
        self._announcement = announcement
        if self._link is not None:
            self._link.retained.announce(announcement)

    def take_states_due(self) -> bool:
        """Return, once each time, whether states are to be published again; see `Discoverable`."""
        return self._link is not None and self._link.retained.take_states_due()

    def take_forgotten(self) -> bool:
        """Return, once each time, whether the broker has forgotten what it kept; see `Discoverable`."""
        return self._link is not None and self._link.retained.take_forgotten()

    def trouble(self) -> str:
        """Return in words what is wrong with the connection, or an empty string if it stands."""
        return self._link.trouble() if self._link else f"the messenger for {self._options.place} is not open"

    def close(self) -> None:
        """Say that we go offline, wait a moment at most for what is on its way, and disconnect."""
        if self._link is None:
            return
        self._link.stop()
        self._left = self._link.queue.undelivered()
        self._dropped_before += self._link.queue.dropped
        self._given_up_before += self._link.queue.given_up
        self._link = None
