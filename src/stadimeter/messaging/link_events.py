"""The events of a connection to a broker, as paho reports them, and their messages for people."""

from __future__ import annotations

import socket
import ssl
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
from paho.mqtt.reasoncodes import ReasonCode

from stadimeter.messaging.mqtt_client import MqttSettings
from stadimeter.messaging.outbox import PAGES_MAX

# A connection that ends sooner is not taken for a sign that all is well.
STABLE_S = 10.0

# After this many connections in a row that ended soon, two programs with one name are suspected.
SUSPICIOUS = 3


# Takes a message of a topic that was subscribed to. It is called in the link's thread, within paho's loop.
Handler = Callable[[MQTTMessage], None]


class LinkEvents:
    """Collects the events of paho's callbacks, without a lock.

    All callbacks come in the link's thread, within paho's loop, and so does every call here, save that `refusal` may
    be read by any thread.

    Attributes:
        ending: Why the newest attempt to connect failed, or the connection ended, in words.
        suspects_version: Whether the broker seems not to speak the version of MQTT that was tried.
        was_taken_over: Whether another program with our client id took our place.
        oversized_packets: How often the other side announced more than a broker has to say to us.
        refusal: Why the broker would not take a message over this connection, in words.
        subscribed_at_s: When the broker answered our subscriptions, by the number of each.
        handlers: Who takes the messages of a topic.
        packet_max: The largest packet that the broker takes; None if it does not say.
        has_identifiers: Whether the broker marks messages with the subscription that they come from.

    Args:
        hear: Takes a message that is no page of the list and has no handler, within paho's loop.
    """

    def __init__(self, options: MqttSettings, hear: Callable[[MQTTMessage], None] = lambda _message: None) -> None:
        self._options = options
        self._hear = hear
        self._page_topic = f"{options.base}/{options.retained_topic}/"
        self._answered: deque[tuple[int, list[ReasonCode]]] = deque()
        self._done: deque[tuple[int, bool]] = deque()
        self._short_lives = 0
        self._was_ever_accepted = False
        self._pages: deque[tuple[str, bytes]] = deque(maxlen=PAGES_MAX)
        self.oversized_packets = 0
        self.refusal = ""
        self.handlers: dict[str, Handler] = {}
        self.begin()

    def begin(self) -> None:
        """Forget the last attempt to connect; another begins."""
        self.ending = ""
        self.suspects_version = False
        self.was_taken_over = False
        self.subscribed_at_s: dict[int | None, float] = {}
        self.packet_max: int | None = None
        self.has_identifiers = True
        self._pages.clear()
        self._answered.clear()
        self._accepted_at_s: float | None = None
        self._stood_s = 0.0

    @property
    def is_accepted(self) -> bool:
        """True if the broker accepted us in this attempt."""
        return self._accepted_at_s is not None

    @property
    def was_stable(self) -> bool:
        """True if the connection that ended had stood for a good while."""
        return self._stood_s > STABLE_S

    def listen_to(self, client: Client) -> None:
        """Have a client tell us."""
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_publish = self._on_publish
        client.on_subscribe = self._on_subscribe
        client.on_message = self._on_message

    def note_connect_error(self, error: OSError) -> None:
        """Note that there is no connection at all."""
        self.ending = describe_connect_error(self._options, error)

    def note_no_answer(self) -> None:
        """Note that the broker took the connection and then said nothing."""
        self.ending = describe_silence(self._options, had_answered=False)
        self.suspects_version = not self._was_ever_accepted

    def note_oversized_packet(self) -> None:
        """Note that the other side announced more than a broker has to say to us."""
        self.oversized_packets += 1
        if not self.is_accepted:
            self.note_nonsense()
        else:
            self.ending = f"{self._options.place} sent a message that is too large to be an answer to this program"

    def note_nonsense(self) -> None:
        """Note that the other side sent what is not MQTT."""
        self.ending = describe_non_mqtt(self._options)
        self.suspects_version = not self._was_ever_accepted

    def note_unsendable(self, topic: str, error: ValueError) -> None:
        """Note that a message cannot be packed, such as one whose text is no Unicode."""
        self.refusal = f"a message for '{topic[:200]}' cannot be sent: {error}"

    def take_done(self) -> Iterator[tuple[int, bool]]:
        """Yield, once each, the messages that were written (QoS 0) or answered (QoS 1): number, and if refused."""
        while self._done:
            yield self._done.popleft()

    def take_subscribed(self) -> Iterator[tuple[int, list[ReasonCode]]]:
        """Yield, once each, the broker's answers to subscriptions to requests: number, and a code for each topic."""
        while self._answered:
            yield self._answered.popleft()

    def take_pages(self) -> Iterator[tuple[str, bytes]]:
        """Yield, once each, the messages that came: the last part of the topic, and the payload."""
        while self._pages:
            yield self._pages.popleft()

    def _on_connect(self, _client: Client, _data: Any, _flags: ConnectFlags, reason: ReasonCode, more: Any) -> None:
        if reason.is_failure:
            self.ending = describe_refusal(self._options, reason)
            self.suspects_version = reason.value == UNSUPPORTED_VERSION
            return
        self._accepted_at_s = time.monotonic()
        self._was_ever_accepted = True
        self.refusal = ""
        self.packet_max = getattr(more, "MaximumPacketSize", None)
        self.has_identifiers = bool(getattr(more, "SubscriptionIdentifierAvailable", 1))

    def _on_disconnect(
        self, _client: Client, _data: Any, flags: DisconnectFlags, reason: ReasonCode, _more: Any
    ) -> None:
        if self._accepted_at_s is not None:
            self._stood_s = time.monotonic() - self._accepted_at_s
            self._short_lives = 0 if self.was_stable else self._short_lives + 1
        if self.ending:
            return
        # Few brokers say that two programs take the connection from each other, and with MQTT 3.1.1 none can.
        guess = f" (does another program use the client id '{self._options.client_id}'?)"
        guess = guess if self._short_lives >= SUSPICIOUS else ""
        if flags.is_disconnect_packet_from_server:
            self.was_taken_over = reason.value == TAKEN_OVER
            self.ending = describe_disconnect(self._options, reason) + ("" if self.was_taken_over else guess)
            return
        self.suspects_version = not self._was_ever_accepted
        self.ending = describe_loss(self._options, reason, had_answered=self.is_accepted) + guess

    def _on_publish(self, _client: Client, _data: Any, number: int, reason: ReasonCode, _more: Any) -> None:
        if reason.is_failure:
            place = self._options.discovery_place
            or_to = f" or to '{place.topic}'" if place is not None else ""
            below = f"a message below '{self._options.base}'{or_to} ({reason})"
            self.refusal = f"{self._options.place} refused {below}; check the broker's access list"
        self._done.append((number, reason.is_failure))

    def _on_subscribe(self, _client: Client, _data: Any, number: int, codes: list[ReasonCode], _more: Any) -> None:
        self.subscribed_at_s[number] = time.monotonic()
        self._answered.append((number, codes))

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        with suppress(UnicodeDecodeError):
            if message.topic.startswith(self._page_topic):
                self._pages.append((message.topic.rpartition("/")[2], bytes(message.payload)))
            else:
                self.handlers.get(message.topic, self._hear)(message)


UNSUPPORTED_VERSION = 0x84
BAD_LOGIN = 0x86
NOT_AUTHORISED = 0x87
NO_MQTT = 0x82
KEEPALIVE = 0x8D
TAKEN_OVER = 0x8E


def describe_connect_error(options: MqttSettings, error: OSError) -> str:
    """Say why there is no connection at all, in one line."""
    place = options.place
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the certificate of {place} is not trusted: {error.verify_message}; name its authority in ca_file"
    if isinstance(error, socket.gaierror):
        return f"no address is known for the host '{options.host}' ({error.strerror})"
    if isinstance(error, ConnectionRefusedError):
        return f"{place} refused the connection (is a broker running there?)"
    return f"{place} {_trouble(error)}" + (" (is this its port for TLS?)" if options.tls else "")


def _trouble(error: OSError) -> str:
    if isinstance(error, TimeoutError):
        return "does not answer"
    if isinstance(error, ConnectionResetError):
        return "hung up without an answer"
    if isinstance(error, ssl.SSLError):
        return f"does not speak TLS as expected: {error.strerror or error}"
    return f"cannot be reached: {error.strerror or error}"


def describe_refusal(options: MqttSettings, reason: ReasonCode) -> str:
    """Say why the broker would not have us."""
    if reason.value in {NOT_AUTHORISED, BAD_LOGIN}:
        who = f"the login of '{options.username}'" if options.username else "a connection without a login"
        return f"{options.place} refused {who} ({reason}); check username and password_file"
    if reason.value == UNSUPPORTED_VERSION:
        return f"{options.place} does not speak MQTT {options.protocol}; set protocol to 'auto'"
    return f"{options.place} refused the client '{options.client_id}' ({reason})"


def describe_disconnect(options: MqttSettings, reason: ReasonCode) -> str:
    """Say why the broker ended the connection."""
    if reason.value == TAKEN_OVER:
        return f"another program uses the client id '{options.client_id}' at {options.place}; give each its own node"
    return f"{options.place} ended the connection ({reason})"


def describe_loss(options: MqttSettings, reason: ReasonCode, *, had_answered: bool) -> str:
    """Say how a connection ended without a word from the broker."""
    if reason.value == KEEPALIVE:
        return describe_silence(options, had_answered=had_answered)
    if reason.value == NO_MQTT:
        return describe_non_mqtt(options)
    if not had_answered:
        return f"{options.place} hung up without an answer (is it an MQTT broker, with TLS as configured?)"
    return f"the connection to {options.place} was lost"


def describe_non_mqtt(options: MqttSettings) -> str:
    """Say, in one line, that what was received is not MQTT."""
    return f"{options.place} does not answer as an MQTT broker does"


def describe_silence(options: MqttSettings, *, had_answered: bool) -> str:
    """Say that the broker says nothing."""
    return f"{options.place} has stopped answering" if had_answered else f"{options.place} does not answer"
