"""Whoever publishes never waits for the link's thread, whatever that is about."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from paho.mqtt.client import Client, MQTTMessageInfo

from stadimeter.core.message import Message
from stadimeter.messaging.mqtt import PahoMessenger
from stadimeter.testing.rig import eventually

ALARM = "stadimeter/it/event/alarm"

MakeMessenger = Callable[..., PahoMessenger]


def alarm(number: int) -> Message:
    return Message(topic="event/alarm", payload=str(number), qos=1)


def test_publishing_does_not_wait_for_a_thread_that_is_in_paho(broker, make_messenger, listen, monkeypatch):
    listener = listen(broker.port)
    messenger = make_messenger(broker.port)
    messenger.open()
    eventually(lambda: not messenger.trouble())
    is_in_paho, may_go_on = threading.Event(), threading.Event()
    publish = Client.publish

    def hang(*args: Any, **options: Any) -> MQTTMessageInfo:
        is_in_paho.set()
        assert may_go_on.wait(60.0)
        return publish(*args, **options)

    monkeypatch.setattr(Client, "publish", hang)
    count = 150
    messenger.publish(alarm(0))
    assert is_in_paho.wait(60.0)
    for number in range(1, count):
        messenger.publish(alarm(number))
    assert [each.payload for each in messenger.undelivered()] == [str(number) for number in range(count)]
    assert (messenger.trouble(), messenger.given_up, messenger.dropped) == ("", 0, 0)
    may_go_on.set()
    listener.wait_for_payloads(ALARM, [str(number) for number in range(count)])


def test_a_message_that_cannot_be_packed_is_given_up_and_said_and_those_behind_it_go(broker, make_messenger, listen):
    listener = listen(broker.port)
    messenger = make_messenger(broker.port)
    messenger.open()
    eventually(lambda: not messenger.trouble())
    messenger.publish(Message(topic="event/alarm", payload="\ud800", qos=1))
    messenger.publish(Message(topic="target/ball/state", payload="\ud800"))
    messenger.publish(alarm(1))
    listener.wait_for(ALARM, "1")
    assert (messenger.given_up, messenger.dropped) == (1, 1)
    assert messenger.trouble().startswith(
        "a message for 'target/ball/state' cannot be sent: 'utf-8' codec can't encode"
    )
