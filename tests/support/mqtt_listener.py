"""Programs beside a run: one that remembers everything that a broker passes on, and one that asks for something."""

from __future__ import annotations

import itertools
import json
import threading
import time
from collections.abc import Callable
from typing import Any, Self

from msgspec import Struct
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from support.broker import HOST

WAIT_S = 120.0


class Heard(Struct, frozen=True, kw_only=True):
    """A message as a subscriber gets it.

    Attributes:
        data: The payload; `payload` has it as a text.
        qos: The quality of service that it came with.
        is_retained: Whether the broker had kept it from before the subscription.
        expires_s: What is left of its life; None for ever, or where MQTT 5 is not spoken.
        at_s: When it came, on the clock of `time.perf_counter`.
    """

    topic: str
    data: bytes
    qos: int
    is_retained: bool
    expires_s: int | None
    correlation: bytes | None
    content_type: str | None
    at_s: float

    @property
    def payload(self) -> str:
        """The payload as a text."""
        return self.data.decode()


class MqttListener:
    """Subscribes at QoS 1, to everything unless topics are named. Use it in a ``with`` statement.

    Args:
        port: The broker's port on the loopback interface.
        login: Name and password; None for none.
        is_v5: Whether to speak MQTT 5, which shows expiries; else 3.1.1, which every broker speaks.
    """

    def __init__(
        self, port: int, login: tuple[str, str] | None = None, *, is_v5: bool = False, topics: tuple[str, ...] = ("#",)
    ) -> None:
        self._port = port
        self._topics = [(topic, 1) for topic in topics]
        self._changed = threading.Condition()
        self._heard: list[Heard] = []
        self._is_subscribed = False
        version = MQTTProtocolVersion.MQTTv5 if is_v5 else MQTTProtocolVersion.MQTTv311
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=version)
        if login is not None:
            self._client.username_pw_set(*login)
        self._client.on_message = self._on_message
        self._client.on_subscribe = self._on_subscribe

    def __enter__(self) -> Self:
        """Subscribe; return when the broker has confirmed it."""
        self._client.connect(HOST, self._port)
        self._client.loop_start()
        self._client.subscribe(self._topics)
        self._wait(lambda: self._is_subscribed, "the subscription")
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect."""
        self._client.disconnect()
        self._client.loop_stop()
        # Else it would be freed with this listener in one circle, and its sockets perhaps before it has closed them.
        self._client.on_message = self._client.on_subscribe = None

    def drain(self) -> None:
        """Wait until everything is heard that the broker had acknowledged by now: it passes messages on in order."""
        with self._changed:
            topic = f"drained/{len(self._heard)}"
        self._client.publish(topic, qos=1)
        self.wait_for(topic)

    @property
    def heard(self) -> list[Heard]:
        """Everything so far, in order."""
        with self._changed:
            return list(self._heard)

    def forget(self) -> None:
        """Forget what was heard."""
        with self._changed:
            self._heard.clear()

    def payloads(self, topic: str) -> list[str]:
        """Return what came on one topic, in order."""
        return [heard.payload for heard in self.heard if heard.topic == topic]

    def wait_for(self, topic: str, payload: str | None = None) -> Heard:
        """Wait for a message, which may have come already.

        Args:
            payload: The payload; None for any.

        Raises:
            AssertionError: None came in time.
        """

        def first() -> Heard | None:
            of_topic = (heard for heard in self._heard if heard.topic == topic)
            return next((heard for heard in of_topic if payload is None or heard.payload == payload), None)

        found: Heard = self._wait(first, f"{topic} {payload or ''}")
        return found

    def wait_for_payloads(self, topic: str, payloads: list[str]) -> None:
        """Wait until exactly these payloads have come on a topic, in this order.

        Raises:
            AssertionError: They did not come in time.
        """
        self._wait(
            lambda: [heard.payload for heard in self._heard if heard.topic == topic] == payloads, f"{topic} {payloads}"
        )

    def _wait(self, condition: Callable[[], Any], wanted: str) -> Any:
        with self._changed:
            found = self._changed.wait_for(condition, WAIT_S)
            assert found, f"{wanted} did not come; heard: {self._heard[-20:]}"
            return found

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        properties = message.properties
        heard = Heard(
            topic=message.topic,
            data=message.payload,
            qos=message.qos,
            is_retained=message.retain,
            expires_s=getattr(properties, "MessageExpiryInterval", None),
            correlation=getattr(properties, "CorrelationData", None),
            content_type=getattr(properties, "ContentType", None),
            at_s=time.perf_counter(),
        )
        with self._changed:
            self._heard.append(heard)
            self._changed.notify_all()

    def _on_subscribe(self, *_: Any) -> None:
        with self._changed:
            self._is_subscribed = True
            self._changed.notify_all()


BASE = "stadimeter/it"


class MqttAsker(MqttListener):
    """Asks a run for something, and hears its responses and pictures."""

    def __init__(self, port: int, *, is_v5: bool = True, also: tuple[str, ...] = ()) -> None:
        super().__init__(port, is_v5=is_v5, topics=(f"{BASE}/response/+", f"{BASE}/snapshot", *also))
        self._is_v5 = is_v5
        self._numbers = itertools.count(1)
        self._client.max_queued_messages_set(0)

    def send(self, action: str, payload: bytes | str, *, retain: bool = False, **properties: Any) -> Any:
        """Send whatever it is to the topic of an action."""
        of_v5 = Properties(PacketTypes.PUBLISH)
        for name, value in properties.items():
            setattr(of_v5, name, value)
        return self._client.publish(f"{BASE}/request/{action}", payload, 1, retain, of_v5 if self._is_v5 else None)

    def ask(self, action: str, **args: Any) -> Any:
        """Ask for an action, and return the answer to it: its data, or its error."""
        number = f"asked-{next(self._numbers)}"
        self.send(action, json.dumps({**args, "transaction": number}))
        answer = self.answer(action, number)
        return answer["data"] if answer["status"] == "ok" else answer["error"]

    def answer(self, action: str, transaction: Any) -> Any:
        """Wait for the answer with a transaction."""

        def found() -> Any:
            answers = (json.loads(each.data) for each in self._heard if each.topic == f"{BASE}/response/{action}")
            return next((each for each in answers if each["transaction"] == transaction), None)

        return self._wait(found, f"an answer to {action} {transaction}")
