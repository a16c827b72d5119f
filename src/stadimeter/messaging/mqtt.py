"""The messenger that speaks MQTT, through paho."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Collection, Sequence
from typing import Any

from paho.mqtt.client import Client, MQTTMessage

from stadimeter.config.plugins import DriverContext
from stadimeter.core.home_assistant import DiscoveryPlace
from stadimeter.core.message import REQUEST, Message
from stadimeter.errors import ConfigError, DeviceClosedError, DeviceOpenError
from stadimeter.messaging.broker_link import V5, V311, BrokerLink, RequestTopics, serve
from stadimeter.messaging.mqtt_client import (
    LinkEvents,
    MqttSettings,
    make_client,
    publish_properties,
    read_secrets,
    say_goodbye,
)
from stadimeter.messaging.protocol import BackOff, CommandLevel, Patience, Received, RequestMessage
from stadimeter.operator_actions import OperatorAction

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

    def subscribe(self, filters: Sequence[str], take: Callable[[Received], None]) -> MqttSubscription:
        """Return a subscription, not connected yet; see `stadimeter.messaging.protocol.Subscribes`."""
        return MqttSubscription(self, filters, take)

    def reach(self) -> str:
        """Connect once with this login, hang up, and return what is wrong, or an empty string.

        It has a client id of its own, for a broker would throw out a running instance of the same id, and no last will.
        """
        orders = [f"{self.base}/{REQUEST.of(OperatorAction.STOP_OUTPUTS)}"] if self.commands != "off" else []
        try:
            asking = MqttSubscription(
                self, orders, lambda _message: None, Patience(answer_s=ASKED_S, first_pause_s=0.1)
            )
        except DeviceOpenError as error:
            return str(error)
        until_s, tries = time.monotonic() + 3 * ASKED_S, 2 if self.protocol == "auto" else 1
        while not asking.is_listening and asking.failures < tries and time.monotonic() < until_s:
            asking.serve(ASKED_S / 10)
        trouble = asking.trouble()
        asking.close()
        return trouble


class PahoMessenger:
    """Publishes to an MQTT broker.

    A thread of its own does all that can wait for the network. Messages of QoS 1 wait in memory while there is no
    connection. It is opened once: what is left when it is closed is sent by the next run.

    Attributes:
        orders: The topics below the base topic to which others may send; see `Discoverable`.
    """

    def __init__(self, options: MqttOptions, patience: Patience = Patience()) -> None:  # noqa: B008 - it is frozen
        self._options = options
        self._link = BrokerLink(options, patience)
        self._is_open = False
        self.orders: frozenset[str] = frozenset()
        self.undelivered = self._link.queue.undelivered
        self.deafness = self._link.deafness
        self.retain_only = self._link.retained.retain_only
        self.announce = self._link.retained.announce
        self.take_states_due = self._link.retained.take_states_due
        self.take_forgotten = self._link.retained.take_forgotten

    @property
    def dropped(self) -> int:
        """Number of messages of QoS 0 that were lost for want of a connection, and states of QoS 1 replaced unsent."""
        return self._link.queue.dropped

    @property
    def given_up(self) -> int:
        """Number of messages of QoS 1 that were given up: too many waited, they expired, or the broker refused them."""
        return self._link.queue.given_up

    @property
    def commands(self) -> CommandLevel:
        """The commands that other programs may ask for."""
        return self._options.commands

    @property
    def discovery_place(self) -> DiscoveryPlace | None:
        """The place at which Home Assistant discovers this node; see `Discoverable`."""
        return self._options.discovery_place

    def open(self) -> None:
        """Begin to connect and return at once. A broker that is away is not an error."""
        if not self._is_open:
            self._link.start(read_secrets(self._options))
            self._is_open = True

    def publish(self, message: Message) -> None:
        """Hand a message over and return at once.

        Raises:
            ConfigError: Its topic cannot be one.
        """
        if not message.topic or not _NOT_IN_TOPICS.isdisjoint(message.topic):
            raise ConfigError(f"{message.topic!r} is not a topic to publish to; rename what it is made from")
        if not self._is_open:
            raise DeviceClosedError(f"the messenger for {self._options.place} is not open; open it first")
        self._link.queue.send(message)

    def listen(
        self, topics: Collection[str], offered: Collection[str], receive: Callable[[RequestMessage], None]
    ) -> None:
        """Receive what comes on topics of requests; see `TakesRequests`."""
        self.orders = frozenset(offered)
        self._link.requests = RequestTopics(self._options, topics, receive)

    def respond(self, request: RequestMessage, topic: str, payload: bytes) -> None:
        """Answer a request; see `TakesRequests`."""
        place = request.response_topic or f"{self._options.base}/{topic}"
        self._link.send_now(place, payload, "application/json", request.correlation)

    def show(self, topic: str, payload: bytes, content_type: str) -> bool:
        """Send a picture; return whether it can be sent."""
        return self._link.send_now(f"{self._options.base}/{topic}", payload, content_type)

    def trouble(self) -> str:
        """Return in words what is wrong with the connection, or an empty string if it stands."""
        return self._link.trouble() if self._is_open else f"the messenger for {self._options.place} is not open"

    def close(self) -> None:
        """Say that we go offline, wait a moment at most for what is on its way, and disconnect."""
        if self._is_open:
            self._is_open = False
            self._link.stop()


# A program that listens to topics of others ---------------------------------------------------------


# A person waits: the screen stands still while a connection is tried.
PATIENCE = Patience(answer_s=3.0, longest_pause_s=10.0)


class MqttSubscription:
    """Listens to a broker, in the thread that calls `serve`. It has a client id of its own and no last will.

    Args:
        filters: The topics, with wildcards. They should not overlap: a broker may send a message once for each.
        take: Takes each message, within `serve`.

    Attributes:
        is_listening: Whether the broker has answered what is listened to.
        failures: How often connecting failed, or a connection ended.
    """

    def __init__(
        self,
        options: MqttSettings,
        filters: Sequence[str],
        take: Callable[[Received], None],
        patience: Patience = PATIENCE,
    ) -> None:
        self._options = options.model_copy(update={"node": f"{options.node}-{uuid.uuid4().hex[:8]}"})
        self._secrets = read_secrets(options)
        self._filters, self._take, self._patience = filters, take, patience
        self._events = LinkEvents(self._options)
        self._back_off = BackOff(patience)
        self._client: Client | None = None
        self._version = V311 if options.protocol == "3.1.1" else V5
        self._next_try_s = self._answer_until_s = 0.0
        self._why_not = f"not connected to {options.place} yet"
        self._refusal = ""
        self.is_listening = False
        self.failures = 0

    def trouble(self) -> str:
        """Describe what is wrong with the connection; empty while the broker has taken the subscription."""
        return self._refusal or ("" if self.is_listening else self._why_not)

    def serve(self, wait_s: float) -> None:
        """Connect if it is time to, and hand over what arrives, for that long at most. Connecting may take longer."""
        until_s = time.monotonic() + wait_s
        while (now_s := time.monotonic()) < until_s:
            if self._client is not None:
                self._serve(self._client, until_s - now_s)
            elif now_s >= self._next_try_s:
                self._connect()
            else:
                time.sleep(min(until_s, self._next_try_s) - now_s)

    def publish(self, topic: str, payload: str, expires_s: int | None) -> None:
        """Send a message with QoS 1; see `stadimeter.messaging.protocol.Subscription`."""
        if self._client is not None:
            message = Message(topic=topic, payload=payload, expires_s=expires_s)
            properties = publish_properties(message) if self._version == V5 else None
            self._client.publish(topic, payload, qos=1, retain=expires_s is None, properties=properties)

    def close(self) -> None:
        """Disconnect, so that the broker forgets the session."""
        if self._client is not None:
            say_goodbye(self._client, self._version)
            serve(self._client.loop, self._events, 0.0)
            self._drop_client()

    def _connect(self) -> None:
        self._events.begin()
        client = make_client(self._options, self._secrets, self._version, self._patience.answer_s)
        client.will_clear()
        self._events.listen_to(client)
        client.on_message, client.on_subscribe = self._on_message, self._on_subscribe
        self._client, self._refusal, self.is_listening = client, "", False
        self._answer_until_s = time.monotonic() + self._patience.answer_s
        try:
            client.reconnect()
        except OSError as error:
            self._events.note_connect_error(error)
            self._lose()

    def _serve(self, client: Client, wait_s: float) -> None:
        was_accepted = self._events.is_accepted
        stands = serve(client.loop, self._events, min(wait_s, 0.5 if was_accepted else 0.1))  # it pings in between
        if stands and self._events.is_accepted and not was_accepted:
            self.is_listening = not self._filters
            if self._filters:
                client.subscribe([(each, 1) for each in self._filters])
        elif stands and not self._events.is_accepted and time.monotonic() > self._answer_until_s:
            self._events.note_no_answer()  # later on, what the broker kept may come first, and it is asked for a sign
            stands = False
        if not stands:
            self._lose()

    def _lose(self) -> None:
        """Let go of a connection that is none, and set when the next is tried."""
        self._why_not, self.failures = self._events.ending or self._why_not, self.failures + 1
        if self._events.was_stable:
            self._back_off.reset()
        if self._options.protocol == "auto" and self._events.suspects_version:
            self._version = V5 if self._version == V311 else V311
        self._next_try_s = time.monotonic() + self._back_off.next_s()
        self._drop_client()

    def _drop_client(self) -> None:
        if self._client is not None and (connection := self._client.socket()) is not None:
            connection.close()
        self._client, self.is_listening = None, False

    def _on_subscribe(self, _client: Client, _data: Any, _number: int, reasons: Sequence[Any], _more: Any) -> None:
        self.is_listening = True
        for topic, reason in zip(self._filters, reasons, strict=False):
            if reason.is_failure:
                words = f"refused the subscription to '{topic}' ({reason}); check the broker's access list"
                self._refusal = f"{self._options.place} {words}"

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        try:
            topic = message.topic
        except UnicodeDecodeError:
            return
        expires_s = getattr(message.properties, "MessageExpiryInterval", None)
        self._take(
            Received(topic=topic, payload=bytes(message.payload), is_retained=message.retain, expires_s=expires_s)
        )
