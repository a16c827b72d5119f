"""A program that asks a run for something over MQTT, and hears what it answers."""

from __future__ import annotations

import itertools
import json
import threading
from typing import Any, Self

from msgspec import Struct
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from support.broker import HOST

WAIT_S = 120.0


class Heard(Struct, frozen=True, kw_only=True):
    """A response, or a picture."""

    topic: str
    payload: bytes
    correlation: bytes | None
    content_type: str | None
    is_retained: bool


class MqttAsker:
    """Subscribes to responses and pictures of a base, and asks. Use it in a ``with`` statement."""

    def __init__(
        self, port: int, base: str = "stadimeter/it", *, is_v5: bool = True, also: tuple[str, ...] = ()
    ) -> None:
        self._base = base
        self._is_v5 = is_v5
        self._numbers = itertools.count(1)
        self._changed = threading.Condition()
        self._topics = [f"{base}/response/+", f"{base}/snapshot", *also]
        self._is_subscribed = False
        self.heard: list[Heard] = []
        version = MQTTProtocolVersion.MQTTv5 if is_v5 else MQTTProtocolVersion.MQTTv311
        self.client = Client(CallbackAPIVersion.VERSION2, protocol=version)
        self.client.on_connect = lambda client, *_: client.subscribe([(topic, 1) for topic in self._topics])
        self.client.on_subscribe = self._on_subscribe
        self.client.on_message = self._on_message
        self.client.max_queued_messages_set(0)
        self._port = port

    def __enter__(self) -> Self:
        """Connect and subscribe; return when the broker has confirmed it."""
        self.client.connect(HOST, self._port)
        self.client.loop_start()
        self._wait(lambda: self._is_subscribed, "the subscription")
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect."""
        self.client.disconnect()
        self.client.loop_stop()
        # Else it would be freed with this asker in one circle, and its sockets perhaps before it has closed them.
        self.client.on_connect = self.client.on_subscribe = self.client.on_message = None

    def send(self, action: str, payload: bytes | str, *, retain: bool = False, **properties: Any) -> Any:
        """Send whatever it is to the topic of an action."""
        of_v5 = Properties(PacketTypes.PUBLISH)
        for name, value in properties.items():
            setattr(of_v5, name, value)
        topic = f"{self._base}/request/{action}"
        return self.client.publish(topic, payload, 1, retain, of_v5 if self._is_v5 else None)

    def ask(self, action: str, **args: Any) -> Any:
        """Ask for an action, and return the answer to it: its data, or its error."""
        number = f"asked-{next(self._numbers)}"
        self.send(action, json.dumps({**args, "transaction": number}))
        answer = self.answer(action, number)
        return answer["data"] if answer["status"] == "ok" else answer["error"]

    def answer(self, action: str, transaction: Any) -> Any:
        """Wait for the answer with a transaction."""
        return self._wait(lambda: self._answer(action, transaction), f"an answer to {action} {transaction}")

    def wait_for(self, topic: str) -> Heard:
        """Wait for a message on a topic, and return the newest."""
        found = self._wait(lambda: [each for each in self.heard if each.topic == topic], topic)
        return found[-1]  # type: ignore[no-any-return]

    def _answer(self, action: str, transaction: Any) -> Any:
        of_action = [each for each in self.heard if each.topic == f"{self._base}/response/{action}"]
        answers = [json.loads(each.payload) for each in of_action]
        return next((each for each in answers if each["transaction"] == transaction), None)

    def _wait(self, condition: Any, wanted: str) -> Any:
        with self._changed:
            found = self._changed.wait_for(condition, WAIT_S)
            assert found, f"{wanted} did not come; heard: {self.heard[-20:]}"
            return found

    def _on_subscribe(self, *_: Any) -> None:
        with self._changed:
            self._is_subscribed = True
            self._changed.notify_all()

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        properties = message.properties
        heard = Heard(
            topic=message.topic,
            payload=message.payload,
            correlation=getattr(properties, "CorrelationData", None),
            content_type=getattr(properties, "ContentType", None),
            is_retained=message.retain,
        )
        with self._changed:
            self.heard.append(heard)
            self._changed.notify_all()
