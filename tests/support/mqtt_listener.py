"""A subscriber for tests: remembers everything that a broker passes on."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Self

from msgspec import Struct
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from support.broker import HOST

WAIT_S = 120.0


class Heard(Struct, frozen=True, kw_only=True):
    """A message as a subscriber gets it.

    Attributes:
        qos: The quality of service that it came with.
        is_retained: Whether the broker had kept it from before the subscription.
        expires_s: What is left of its life; None for ever, or where MQTT 5 is not spoken.
        at_s: When it came, on the clock of `time.perf_counter`.
    """

    topic: str
    payload: str
    qos: int
    is_retained: bool
    expires_s: int | None
    at_s: float


class MqttListener:
    """Subscribes to everything, at QoS 1. Use it in a ``with`` statement.

    Args:
        port: The broker's port on the loopback interface.
        login: Name and password; None for none.
        is_v5: Whether to speak MQTT 5, which shows expiries; else 3.1.1, which every broker speaks.
    """

    def __init__(self, port: int, login: tuple[str, str] | None = None, *, is_v5: bool = False) -> None:
        self._port = port
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
        self._client.subscribe("#", qos=1)
        with self._changed:
            assert self._changed.wait_for(lambda: self._is_subscribed, WAIT_S), "the broker does not answer"
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect."""
        self._client.disconnect()
        self._client.loop_stop()
        self._client.on_message = self._client.on_subscribe = None

    def drain(self) -> None:
        """Wait until everything is heard that the broker had acknowledged by now: it passes messages on in order."""
        with self._changed:
            topic = f"drained/{len(self._heard)}"
            self._client.publish(topic, qos=1)
            drained = self._changed.wait_for(lambda: any(each.topic == topic for each in self._heard), WAIT_S)
        assert drained, "the broker does not pass on what it has"

    @property
    def heard(self) -> list[Heard]:
        """Everything so far, in order."""
        with self._changed:
            return list(self._heard)

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

        def is_it(heard: Heard) -> bool:
            return heard.topic == topic and payload in {None, heard.payload}

        self._wait(lambda: any(is_it(heard) for heard in self._heard), f"{topic} {payload or ''}")
        return next(heard for heard in self.heard if is_it(heard))

    def wait_for_payloads(self, topic: str, payloads: list[str]) -> None:
        """Wait until exactly these payloads have come on a topic, in this order.

        Raises:
            AssertionError: They did not come in time.
        """
        self._wait(
            lambda: [heard.payload for heard in self._heard if heard.topic == topic] == payloads, f"{topic} {payloads}"
        )

    def _wait(self, condition: Callable[[], bool], wanted: str) -> None:
        with self._changed:
            assert self._changed.wait_for(condition, WAIT_S), f"{wanted} did not come; heard: {self._heard}"

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        expires_s = getattr(message.properties, "MessageExpiryInterval", None)
        heard = Heard(
            topic=message.topic,
            payload=message.payload.decode(),
            qos=message.qos,
            is_retained=message.retain,
            expires_s=expires_s,
            at_s=time.perf_counter(),
        )
        with self._changed:
            self._heard.append(heard)
            self._changed.notify_all()

    def _on_subscribe(self, *_: Any) -> None:
        with self._changed:
            self._is_subscribed = True
            self._changed.notify_all()
