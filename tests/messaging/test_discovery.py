"""What Home Assistant discovers, as it passes real brokers: announced, announced again, and removed."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt import publish

from stadimeter.core.home_assistant import Announcement, Component, DiscoveryPlace, announce, announced_platforms
from stadimeter.core.message import Message
from stadimeter.messaging.mqtt import PahoMessenger
from stadimeter.testing.rig import eventually
from support.broker import HOST
from support.mqtt_listener import MqttListener

CONFIG = "homeassistant/device/stadimeter_it/config"
BIRTH = "homeassistant/status"
RULE = Message(topic="rule/near/state", payload="near", qos=1, retain=True)


def entity(platform: str, key: str) -> Component:
    return {"platform": platform, "unique_id": f"stadimeter_it_{key}", "name": key, "state_topic": "x"}


def announcement(*keys: str, **others: Any) -> Announcement:
    return Announcement(
        place=DiscoveryPlace(node="it", base="stadimeter/it", prefix="homeassistant"),
        version="1",
        components={**{key: entity("sensor", key) for key in keys}, **others},
    )


def ran(messenger: PahoMessenger, announced: Announcement | None, *, opens: bool = True) -> PahoMessenger:
    """Do what a run does at its start, or at a reload."""
    if announced is not None:
        messenger.announce(announced)
    messenger.retain_only(frozenset({RULE.topic}))
    if opens:
        messenger.open()
        messenger.publish(RULE)
    eventually(lambda: not messenger.trouble())
    return messenger


def components(listener: MqttListener, topic: str = CONFIG) -> list[dict[str, Any]]:
    """Return the components of each announcement so far; an empty one stands for the end of the device."""
    return [json.loads(each)["components"] if each else {} for each in listener.payloads(topic)]


def keys_of(listener: MqttListener, topic: str = CONFIG) -> list[list[str]]:
    return [list(each) for each in components(listener, topic)]


@pytest.mark.parametrize("protocol", ["3.1.1", "auto"])
def test_it_is_announced_once_connected_and_kept_for_a_home_assistant_that_starts_later(
    protocol, broker, make_messenger, listen
):
    ran(make_messenger(broker.port, protocol=protocol), announcement("near", "far"))
    listen(broker.port).wait_for(CONFIG)
    heard = listen(broker.port).wait_for(CONFIG)
    assert heard.is_retained
    assert heard.qos == 1
    assert json.loads(heard.payload) == json.loads(announcement("near", "far").message().payload)
    assert json.loads(heard.payload)["components"]["near"]["platform"] == "sensor"


@pytest.mark.long
def test_what_is_no_more_after_a_restart_is_removed_by_one_message_and_then_left_out(broker, make_messenger, listen):
    first = ran(make_messenger(broker.port), announcement("near", "far"))
    witness = listen(broker.port)
    witness.wait_for(CONFIG)
    first.close()
    ran(make_messenger(broker.port), announcement("far", "new"))
    eventually(lambda: keys_of(witness)[-2:] == [["far", "new", "near"], ["far", "new"]])
    assert components(witness)[-2]["near"] == {"platform": "sensor"}


def test_a_reload_removes_and_adds_at_once(broker, make_messenger, listen):
    messenger = ran(make_messenger(broker.port), announcement("near"))
    witness = listen(broker.port)
    witness.wait_for(CONFIG)
    ran(messenger, announcement("far"), opens=False)
    eventually(lambda: keys_of(witness)[-2:] == [["far", "near"], ["far"]])


@pytest.mark.long
def test_a_device_that_is_announced_no_more_leaves_no_ghost(broker, make_messenger, listen):
    first = ran(make_messenger(broker.port), announcement("near"))
    witness = listen(broker.port)
    witness.wait_for(CONFIG)
    first.close()
    ran(make_messenger(broker.port, home_assistant=False), None)
    witness.wait_for(CONFIG, "")


@pytest.mark.long
def test_after_the_birth_of_home_assistant_it_is_announced_again_and_states_are_due(broker, make_messenger, listen):
    messenger = ran(make_messenger(broker.port), announcement("near"))
    witness = listen(broker.port)
    witness.wait_for(CONFIG)
    before = len(witness.payloads(CONFIG))
    assert not messenger.take_states_due(), "what it publishes is sent at the start anyway"
    for payload in ("offline", "online"):
        publish.single(BIRTH, payload, hostname=HOST, port=broker.port)
    eventually(messenger.take_states_due)
    eventually(lambda: len(witness.payloads(CONFIG)) > before)
    assert not messenger.take_states_due()


def test_a_birth_that_the_broker_has_kept_is_none(broker, make_messenger, listen):
    publish.single(BIRTH, "online", qos=1, retain=True, hostname=HOST, port=broker.port)
    messenger = ran(make_messenger(broker.port), announcement("near"))
    witness = listen(broker.port)
    witness.wait_for(CONFIG)  # sent after both subscriptions
    assert not messenger.take_states_due()


@pytest.mark.long
def test_a_broker_that_forgot_all_gets_all_again(broker, make_messenger, listen):
    messenger = ran(make_messenger(broker.port), announcement("near"))
    listen(broker.port).wait_for(CONFIG)
    assert not messenger.take_forgotten()
    broker.stop()
    broker.start()
    eventually(messenger.take_states_due)
    listen(broker.port).wait_for(CONFIG)
    eventually(messenger.take_forgotten)


def test_a_broker_that_forbids_the_topic_is_reported_with_its_name(start_broker, make_messenger, tmp_path):
    acl = "user garage\ntopic readwrite stadimeter/#\n"
    strict = start_broker(username="garage", password="secret", acl=acl)
    (tmp_path / "password").write_text("secret")
    messenger = make_messenger(strict.port, username="garage", password_file=str(tmp_path / "password"))
    messenger.announce(announcement("near"))
    messenger.retain_only(frozenset())
    messenger.open()
    eventually(lambda: f"or to '{CONFIG}'" in messenger.trouble())
    assert "access list" in messenger.trouble()


@pytest.mark.parametrize("kept", ["no JSON", "[]", '{"components": {"x": {"platform": "nonsense"}, "y": 1}}'])
def test_what_somebody_else_left_in_its_place_is_replaced(kept, broker, make_messenger, listen):
    publish.single(CONFIG, kept, qos=1, retain=True, hostname=HOST, port=broker.port)
    ran(make_messenger(broker.port), announcement("near"))
    witness = listen(broker.port)
    eventually(lambda: witness.payloads(CONFIG)[-1:] == [announcement("near").message().payload])


@given(
    before=st.sets(st.sampled_from("abcd")),
    now=st.sets(st.sampled_from("abcd")),
    events=st.sets(st.sampled_from("abcd")),
)
def test_exactly_what_is_gone_is_removed(before, now, events):
    event = {key: entity("event", key) for key in events}
    earlier, later = announcement(*before), announcement(*now, **event)
    assert announced_platforms(earlier.message().payload.encode()) == earlier.platforms
    messages = list(announce(later, earlier.platforms, CONFIG))
    gone = (before - now) | (before & events)
    assert len(messages) == (2 if gone else 1)
    first, last = (json.loads(each.payload)["components"] for each in (messages[0], messages[-1]))
    assert {key for key, each in first.items() if set(each) == {"platform"}} == gone
    assert set(last) == now | events
    assert all(each.is_absolute and each.topic == CONFIG and each.retain for each in messages)
