"""Requests of other programs, through real brokers and scripted ones: which are heard, and which must not be heeded."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from paho.mqtt.client import MQTTMessage

from stadimeter.messaging.broker_link import RequestTopics
from stadimeter.messaging.mqtt import MqttOptions, PahoMessenger
from stadimeter.messaging.mqtt_client import LinkEvents
from stadimeter.messaging.protocol import RequestMessage
from stadimeter.testing.rig import eventually
from support.broker import HOST, MosquittoBroker
from support.mqtt_listener import MqttAsker

MakeMessenger = Callable[..., PahoMessenger]
ACTION = "request/reset"


class Inbox:
    """Everything that a messenger received."""

    def __init__(self, messenger: PahoMessenger, *topics: str) -> None:
        self.messages: list[RequestMessage] = []
        self.messenger = messenger
        messenger.listen(topics or (ACTION,), topics or (ACTION,), self.messages.append)

    def refusals(self) -> list[str | None]:
        return [each.refusal for each in self.messages]


@pytest.fixture
def ask(closing: ExitStack) -> Callable[..., MqttAsker]:
    def connect(port: int, *, is_v5: bool = True) -> MqttAsker:
        return closing.enter_context(MqttAsker(port, is_v5=is_v5))

    return connect


def connected(inbox: Inbox, asker: MqttAsker) -> Inbox:
    """Open a messenger, and return when it hears requests."""
    inbox.messenger.open()
    eventually(lambda: not inbox.messenger.trouble())
    eventually(lambda: asker.send("reset", "{}") and threading.Event().wait(0.05) is False and inbox.messages)
    settle(inbox, asker)
    return inbox


def settle(inbox: Inbox, asker: MqttAsker) -> None:
    """Wait until everything that was sent has come, and forget it."""
    asker.send("reset", "last").wait_for_publish(120)
    eventually(lambda: any(each.payload == b"last" for each in inbox.messages))
    inbox.messages.clear()


def test_what_came_while_the_link_was_down_is_stale_and_availability_does_not_flap(
    broker, make_messenger, lay_tunnel, ask, listen
):
    tunnel, asker = lay_tunnel(broker.port), ask(broker.port)
    inbox = connected(Inbox(make_messenger(tunnel.port, protocol="5")), asker)
    witness = listen(broker.port)
    tunnel.cut()
    eventually(inbox.messenger.trouble)
    for number in range(5):
        asker.send("reset", f"while away {number}").wait_for_publish(120)
    tunnel.mend()
    eventually(lambda: not inbox.messenger.trouble())
    eventually(lambda: len(inbox.messages) == 5)
    assert inbox.refusals() == ["stale"] * 5
    eventually(
        lambda: asker.send("reset", "now") and (b"now", None) in [(m.payload, m.refusal) for m in inbox.messages]
    )
    assert "offline" not in witness.payloads("stadimeter/it/availability")


@pytest.mark.parametrize("ends", ["closed", "killed"])
def test_what_came_between_two_runs_is_never_heeded_by_the_second(ends, broker, make_messenger, lay_tunnel, ask):
    tunnel, asker = lay_tunnel(broker.port), ask(broker.port)
    first = connected(Inbox(make_messenger(tunnel.port, protocol="5")), asker)
    if ends == "killed":
        tunnel.cut()
    else:
        first.messenger.close()
    asker.send("reset", "in between").wait_for_publish(120)
    second = Inbox(make_messenger(broker.port, protocol="5"))
    second.messenger.open()
    eventually(lambda: not second.messenger.trouble())
    eventually(lambda: asker.send("reset", "now") and any(each.payload == b"now" for each in second.messages))
    between = [each.refusal for each in second.messages if each.payload == b"in between"]
    # The broker keeps nothing for a run that said goodbye, which on a busy machine may come too late.
    assert between == ["stale"] or (ends == "closed" and between == [])


def test_a_session_of_311_keeps_nothing_while_we_are_away(broker, make_messenger, lay_tunnel, ask):
    tunnel, asker = lay_tunnel(broker.port), ask(broker.port, is_v5=False)
    inbox = connected(Inbox(make_messenger(tunnel.port, protocol="3.1.1")), asker)
    tunnel.cut()
    eventually(inbox.messenger.trouble)
    asker.send("reset", "while away").wait_for_publish(120)
    tunnel.mend()
    eventually(lambda: asker.send("reset", "now") and any(each.payload == b"now" for each in inbox.messages))
    assert all(each.payload == b"now" for each in inbox.messages)


@pytest.mark.parametrize("protocol", ["3.1.1", "5"])
def test_a_message_that_is_too_large_is_no_request(protocol, broker, make_messenger, ask):
    asker = ask(broker.port)
    inbox = connected(Inbox(make_messenger(broker.port, protocol=protocol)), asker)
    asker.send("reset", b"x" * 1_000_000).wait_for_publish(120)
    asker.send("reset", b"y" * 5000).wait_for_publish(120)
    eventually(lambda: "too_large" in inbox.refusals())
    assert {each.payload for each in inbox.messages} == {b""}
    assert inbox.messenger.trouble() == inbox.messenger.deafness() == ""


STRICT = """
{"clients": [{"username": "it", "textname": "", "roles": [{"rolename": "strict"}],
  "password": "", "salt": "", "iterations": 1}],
 "roles": [{"rolename": "strict", "acls": []}],
 "defaultACLAccess": {"publishClientSend": true, "publishClientReceive": true, "subscribe": false, "unsubscribe": true},
 "anonymousGroup": "everyone", "groups": [{"groupname": "everyone", "roles": [], "clients": []}]}
"""


@pytest.fixture
def strict_broker(tmp_path: Path) -> Iterator[MosquittoBroker]:
    """Return a mosquitto that answers each subscription with "not authorised"."""
    found = sorted(Path("/usr/lib").glob("*/mosquitto_dynamic_security.so"))
    if not found:
        pytest.skip("this mosquitto comes without its plugin for roles")
    (tmp_path / "roles.json").write_text(STRICT)
    broker = MosquittoBroker(tmp_path)
    lines = f"\nplugin {found[0]}\nplugin_opt_config_file {tmp_path / 'roles.json'}\n"
    broker._file.write_text(broker._file.read_text() + lines)
    broker.start()
    yield broker
    broker.stop()


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_a_subscription_that_is_refused_is_said_in_words_and_keeps_nothing_else_from_working(
    protocol, strict_broker, make_messenger
):
    messenger = make_messenger(strict_broker.port, protocol=protocol)
    Inbox(messenger, ACTION, "request/arm")
    messenger.open()
    words = eventually(messenger.deafness)
    assert f"{HOST}:{strict_broker.port} refused the subscription to 'stadimeter/it/request/reset' and 1 more" in words
    assert words.endswith("so commands are not heard; check the broker's access list")
    eventually(lambda: not messenger.trouble())
    table = {"host": HOST, "port": strict_broker.port, "node": "it", "protocol": protocol}
    assert "refused the subscription" in MqttOptions.model_validate(table).reach()
    assert MqttOptions.model_validate({**table, "commands": "off"}).reach() == ""


class FakeMessage(MQTTMessage):
    """A message as paho hands it over."""

    def __init__(self, topic: str, payload: bytes = b"{}", *, retain: bool = False, **properties: Any) -> None:
        super().__init__(1, topic.encode())
        self.payload, self.retain = payload, retain
        self.properties = type("Properties", (), properties)()  # type: ignore[assignment]


@pytest.mark.parametrize(
    ("wanted", "heeded"),
    [
        ("my/answers", "my/answers"),
        ("stadimeter/it/response/mine", "stadimeter/it/response/mine"),
        ("stadimeter/other/response/reset", "stadimeter/other/response/reset"),
        ("stadimeter/it/rule/near/state", ""),
        ("stadimeter/it", ""),
        ("my/+/answers", ""),
        ("my/#", ""),
        ("$SYS/broker", ""),
        ("a\0b", ""),
        ("", ""),
    ],
)
def test_a_response_goes_to_no_topic_of_ours_and_to_none_that_cannot_be_published_to(wanted, heeded):
    received: list[RequestMessage] = []
    topics = RequestTopics(MqttOptions(node="it"), [ACTION], received.append)
    topics.begin_over(LinkEvents(MqttOptions(node="it")), is_v5=True)
    known = [topics.identifier]
    topics.hear(FakeMessage(f"stadimeter/it/{ACTION}", ResponseTopic=wanted, SubscriptionIdentifier=known))
    topics.hear(FakeMessage("stadimeter/it/request/other", SubscriptionIdentifier=known))
    assert [(each.response_topic, each.refusal) for each in received] == [(heeded, None)]


def test_a_broker_that_cannot_mark_messages_is_not_listened_to_with_mqtt_5():
    asked: list[Any] = []
    events = LinkEvents(MqttOptions(node="it"))
    events.has_identifiers = False
    client: Any = SimpleNamespace(subscribe=lambda topics: asked.append(topics) or (0, 1))
    topics = RequestTopics(MqttOptions(node="it"), [ACTION], lambda _message: None)
    topics.begin_over(events, is_v5=True)
    topics.attend(client, events)
    assert "cannot mark old messages" in topics.trouble()
    assert asked == []
    topics.begin_over(events, is_v5=False)
    topics.attend(client, events)
    topics.attend(client, events)
    assert asked == [[(f"stadimeter/it/{ACTION}", 1)]]
