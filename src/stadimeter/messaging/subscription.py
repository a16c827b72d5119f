"""A program that listens: subscribed to topics of a broker, and subscribed anew after each loss of the connection."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Sequence
from typing import Any

from paho.mqtt.client import Client, MQTTMessage

from stadimeter.core.message import Message
from stadimeter.messaging.back_off import BackOff, Patience
from stadimeter.messaging.broker_link import V5, V311, serve
from stadimeter.messaging.broker_secrets import read_secrets
from stadimeter.messaging.link_events import LinkEvents
from stadimeter.messaging.mqtt_client import (
    LISTENING_PACKET_MAX,
    ListeningClient,
    MqttSettings,
    make_client,
    publish_properties,
    say_goodbye,
)
from stadimeter.messaging.protocol import Received

# A person waits: the screen stands still while a connection is tried.
PATIENCE = Patience(answer_s=3.0, longest_pause_s=10.0)


class MqttSubscription:
    """Listens to a broker, in the thread that calls `serve`. It has a client id of its own and no last will.

    Args:
        filters: The topics, with wildcards. They should not overlap: a broker may send a message once for each.
        take: Takes each message, within `serve`.
        packet_max: Of a longer packet only the beginning is read; None for `LISTENING_PACKET_MAX`.
    """

    def __init__(
        self,
        options: MqttSettings,
        filters: Sequence[str],
        take: Callable[[Received], None],
        patience: Patience = PATIENCE,
        packet_max: int | None = None,
    ) -> None:
        self._options = options.model_copy(update={"node": f"{options.node}-fleet-{uuid.uuid4().hex[:8]}"})
        self._secrets = read_secrets(options)
        self._filters, self._take, self._patience, self._packet_max = (
            filters,
            take,
            patience,
            packet_max or LISTENING_PACKET_MAX,
        )
        self._events = LinkEvents(self._options)
        self._back_off = BackOff(patience)
        self._client: Client | None = None
        self._version = V311 if options.protocol == "3.1.1" else V5
        self._next_try_s = self._answer_until_s = 0.0
        self._why_not = f"not connected to {options.place} yet"
        self._refusal = ""
        self.is_listening = False

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
        answer_s, packet_max = self._patience.answer_s, self._packet_max
        client = make_client(self._options, self._secrets, self._version, answer_s, ListeningClient, packet_max)
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
            client.subscribe([(each, 1) for each in self._filters])
        elif stands and not self._events.is_accepted and time.monotonic() > self._answer_until_s:
            self._events.note_no_answer()  # later on, what the broker kept may come first, and it is asked for a sign
            stands = False
        if not stands:
            self._lose()

    def _lose(self) -> None:
        """Let go of a connection that is none, and set when the next is tried."""
        self._why_not = self._events.ending or self._why_not
        if self._events.was_stable:
            self._back_off.reset()
        if self._options.protocol == "auto" and self._events.suspects_version:
            self._version = V5 if self._version == V311 else V311
        self._next_try_s = time.monotonic() + self._back_off.spread_s(self._back_off.next_s())
        self._drop_client()

    def _drop_client(self) -> None:
        if self._client is not None and (connection := self._client.socket()) is not None:
            connection.close()
        self._client, self.is_listening = None, False

    def _on_subscribe(self, _client: Client, _data: Any, _number: int, reasons: Sequence[Any], _more: Any) -> None:
        self.is_listening = True
        if any(reason.is_failure for reason in reasons):
            self._refusal = f"{self._options.place} refused a subscription; check the broker's access list"

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        try:
            topic = message.topic
        except UnicodeDecodeError:
            return
        expires_s = getattr(message.properties, "MessageExpiryInterval", None)
        self._take(
            Received(topic=topic, payload=bytes(message.payload), is_retained=message.retain, expires_s=expires_s)
        )
