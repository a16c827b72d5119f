"""A subscription at a real broker: what it brings, what it survives, and what it says meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from stadimeter.messaging.mqtt import MqttOptions, MqttSubscription
from stadimeter.messaging.protocol import Patience, Received
from support.broker import HOST, MosquittoBroker

WAIT_S = 120.0
IMPATIENT = Patience(answer_s=10.0, first_pause_s=0.05, longest_pause_s=0.2)


class Listening:
    """A subscription that is served when something is waited for."""

    def __init__(self, port: int, *filters: str, **options: object) -> None:
        self.received: list[Received] = []
        checked = MqttOptions.model_validate({"host": HOST, "port": port, "node": "it", **options})
        self.subscription = MqttSubscription(checked, filters or ("stadimeter/#",), self.received.append, IMPATIENT)

    def until(self, condition: Callable[[], object]) -> None:
        until_s = time.monotonic() + WAIT_S
        while not condition():
            assert time.monotonic() < until_s, (self.subscription.trouble(), self.received)
            self.subscription.serve(0.02)

    def connected(self) -> Listening:
        self.until(lambda: not self.subscription.trouble())
        return self

    def payloads(self) -> list[bytes]:
        return [message.payload for message in self.received]


@pytest.fixture
def listening(closing: ExitStack) -> Callable[..., Listening]:
    def begin(port: int, *filters: str, **options: object) -> Listening:
        made = Listening(port, *filters, **options)
        closing.callback(made.subscription.close)
        return made

    return begin


@pytest.fixture
def device(broker: MosquittoBroker) -> Iterator[Client]:
    """Return another client of the broker, of the version that every broker speaks."""
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv311)
    client.connect(HOST, broker.port)
    client.loop_start()
    yield client
    client.disconnect()
    client.loop_stop()


def say(device: Client, topic: str, payload: bytes, *, retain: bool = False) -> None:
    device.publish(topic, payload, qos=1, retain=retain).wait_for_publish(WAIT_S)


def test_messages_come_with_whether_the_broker_had_kept_them(broker, device, listening):
    say(device, "stadimeter/garage/info", b"kept", retain=True)
    listener = listening(broker.port).connected()
    listener.until(lambda: listener.received)
    say(device, "stadimeter/garage/event/alarm", b"new")
    listener.until(lambda: len(listener.received) == 2)
    assert [(each.payload, each.is_retained) for each in listener.received] == [(b"kept", True), (b"new", False)]


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_a_message_that_is_too_long_hides_no_other(broker, device, listening, protocol):
    huge = b"x" * 3_000_000
    say(device, "stadimeter/bad/target/ball/state", huge, retain=True)
    listener = listening(broker.port, protocol=protocol).connected()
    say(device, "stadimeter/bad/event/alarm", huge)
    say(device, "stadimeter/garage/event/alarm", b"mine")
    listener.until(lambda: b"mine" in listener.payloads())
    rest = [payload for payload in listener.payloads() if payload != b"mine"]
    assert len(rest) == (0 if protocol == "5" else 2)  # a broker of MQTT 5 is told not to send them
    assert listener.subscription.trouble() == ""


def test_events_that_came_while_the_connection_was_away_arrive_once_it_is_back(broker, device, listening, lay_tunnel):
    tunnel = lay_tunnel(broker.port)
    listener = listening(tunnel.port).connected()
    tunnel.cut()
    listener.until(listener.subscription.trouble)
    sent = [f"{number}".encode() for number in range(300)]
    for payload in sent:
        say(device, "stadimeter/garage/event/alarm", payload)
    tunnel.mend()
    listener.until(lambda: len(listener.received) >= len(sent))
    assert listener.payloads() == sent


def test_a_wrong_password_is_said(start_broker, listening):
    broker = start_broker(username="pi", password="open sesame")
    listener = listening(broker.port)
    listener.until(lambda: "refused a connection without a login" in listener.subscription.trouble())


def test_others_see_no_device_come_or_go(broker, device, listening, listen):
    everything = listen(broker.port)
    listener = listening(broker.port).connected()
    listener.subscription.close()
    say(device, "stadimeter/garage/availability", b"online")
    everything.wait_for("stadimeter/garage/availability")
    assert [heard.topic for heard in everything.heard if not heard.topic.startswith("$SYS")] == [
        "stadimeter/garage/availability"
    ]
