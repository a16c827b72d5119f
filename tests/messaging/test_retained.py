"""What a broker keeps of a run is cleared when it is published no more: by real brokers, over real links."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.message import Message, clearing
from stadimeter.messaging.mqtt import PahoMessenger
from stadimeter.messaging.mqtt_client import PACKET_MAX
from stadimeter.messaging.outbox import LIST_MAX_BYTES, RetainedList
from stadimeter.testing.rig import eventually
from support.mqtt_listener import MqttListener

BASE = "stadimeter/it"
PAGE = f"{BASE}/retained/it"


def state(rule: str) -> Message:
    return Message(topic=f"rule/{rule}/state", payload=rule, qos=1, retain=True)


def topics(*rules: str, also: tuple[str, ...] = ()) -> frozenset[str]:
    return frozenset({state(rule).topic for rule in rules} | set(also))


def ran(messenger: PahoMessenger, *rules: str, also: tuple[str, ...] = ()) -> PahoMessenger:
    """Open a messenger as a run with these rules does."""
    messenger.retain_only(topics(*rules, also=also))
    messenger.open()
    for rule in rules:
        messenger.publish(state(rule))
    for topic in also:
        messenger.publish(Message(topic=topic, payload="x", qos=1, retain=True))
    eventually(lambda: not messenger.trouble())
    eventually(lambda: not messenger.undelivered())
    return messenger


def kept(listener: MqttListener) -> dict[str, str]:
    """Return what the broker keeps, by topic below the base, as a subscriber knows who has heard everything."""
    newest = {heard.topic.removeprefix(f"{BASE}/"): heard.payload for heard in listener.heard}
    return {topic: payload for topic, payload in newest.items() if payload}


@pytest.mark.parametrize("protocol", ["3.1.1", "auto"])
def test_a_rule_that_was_renamed_is_forgotten_by_the_broker_when_the_next_run_connects(
    protocol, broker, make_messenger, listen
):
    witness = listen(broker.port)
    ran(make_messenger(broker.port, protocol=protocol), "near", "far", also=("door/alert",)).close()
    ran(make_messenger(broker.port, protocol=protocol), "nearer", "far")
    witness.wait_for(f"{BASE}/rule/near/state", "")
    witness.wait_for(f"{BASE}/door/alert", "")
    eventually(lambda: set(kept(witness)) == {
        "availability", "rule/nearer/state", "rule/far/state", "retained/it",
    })  # fmt: skip
    assert witness.payloads(f"{BASE}/rule/far/state") == ["far", "far"]


@pytest.mark.long
def test_a_run_that_was_killed_leaves_a_list_too(broker, make_messenger, listen, lay_tunnel):
    tunnel = lay_tunnel(broker.port)
    ran(make_messenger(tunnel.port), "near")
    witness = listen(broker.port)
    assert json.loads(witness.wait_for(PAGE).payload) == ["rule/near/state"]
    tunnel.cut()  # it never comes back, and says no goodbye
    ran(make_messenger(broker.port), "far")
    witness.wait_for(f"{BASE}/rule/near/state", "")


@pytest.mark.long
def test_a_rule_that_was_renamed_while_the_broker_was_away_is_forgotten_when_it_is_back(
    broker, make_messenger, listen, lay_tunnel
):
    tunnel = lay_tunnel(broker.port)
    messenger = ran(make_messenger(tunnel.port), "near")
    witness = listen(broker.port)
    witness.wait_for(PAGE)
    tunnel.cut()
    eventually(messenger.trouble)
    messenger.retain_only(topics("far"))
    tunnel.mend()
    witness.wait_for(f"{BASE}/rule/near/state", "")
    witness.wait_for(PAGE, json.dumps(["rule/far/state"]))


def test_a_reload_while_connected_writes_the_list_anew(broker, make_messenger, listen):
    messenger = ran(make_messenger(broker.port), "near")
    witness = listen(broker.port)
    witness.wait_for(PAGE)
    messenger.retain_only(frozenset())
    witness.wait_for(PAGE, "")


def test_the_list_is_written_though_the_broker_answers_before_the_run_knows_what_it_publishes(
    broker, make_messenger, listen
):
    messenger = make_messenger(broker.port)
    messenger.open()
    eventually(lambda: not messenger.trouble())
    messenger.retain_only(topics("near"))
    listen(broker.port).wait_for(PAGE, json.dumps(["rule/near/state"]))


@pytest.mark.long
def test_another_node_below_the_same_base_keeps_its_own(broker, make_messenger, listen):
    witness = listen(broker.port)
    ran(make_messenger(broker.port, node="one", base_topic="home"), "near")
    witness.wait_for("home/retained/one")
    ran(make_messenger(broker.port, node="two", base_topic="home"), "far")
    witness.wait_for("home/retained/two")
    assert witness.payloads("home/rule/near/state") == ["near"]


def test_a_list_that_somebody_else_wrote_clears_nothing_but_rules_and_messages_of_ours(broker, make_messenger, listen):
    writer = make_messenger(broker.port, node="writer", base_topic=BASE)
    evil = [
        "availability",
        "retained/other",
        "../up",
        "#",
        "rule/+/state",
        "event/alarm",
        "rule/a/b/state",
        1,
        None,
        "",
    ]
    writer.open()
    for topic, payload in [
        ("retained/it", json.dumps([*evil, "rule/gone/state"])),
        ("up", "x"),
    ]:
        writer.publish(Message(topic=topic, payload=payload, qos=1, retain=True))
    eventually(lambda: not writer.undelivered() and not writer.trouble())
    witness = listen(broker.port)
    ran(make_messenger(broker.port), "near")
    witness.wait_for(f"{BASE}/rule/gone/state", "")
    cleared = {heard.topic.removeprefix(f"{BASE}/") for heard in witness.heard if not heard.payload}
    assert cleared == {"rule/gone/state", "../up"}  # which is below the base, and nobody's parent


@pytest.mark.parametrize("protocol", ["3.1.1", "auto"])
def test_a_list_that_is_too_large_costs_one_connection_at_most(protocol, broker, make_messenger, listen):
    writer = make_messenger(broker.port, node="writer", base_topic=BASE)
    writer.open()
    writer.publish(Message(topic="retained/it", payload="x" * 500_000, qos=1, retain=True))
    eventually(lambda: not writer.undelivered() and not writer.trouble())
    messenger = make_messenger(broker.port, protocol=protocol)
    messenger.retain_only(topics("near"))
    messenger.open()
    witness = listen(broker.port)
    messenger.publish(state("near"))
    messenger.publish(Message(topic="event/alarm", payload="raised", qos=1))
    witness.wait_for(f"{BASE}/event/alarm", "raised")
    eventually(lambda: not messenger.trouble() and not messenger.undelivered())


def test_a_login_that_may_write_only_publishes_as_before(broker, start_broker, make_messenger, listen):
    strict = start_broker(acl=f"topic write {BASE}/#\n")
    messenger = ran(make_messenger(strict.port), "near")
    assert (messenger.trouble(), messenger.given_up) == ("", 0)


@given(names=st.sets(st.text(st.characters(codec="utf-8", exclude_characters="+#\0"), min_size=1), max_size=60))
def test_what_is_listed_is_read_back(names):
    written = RetainedList("retained/it", "it")
    written.retain_only(frozenset(f"my/{name}" for name in names))
    read = RetainedList("retained/it", "it")
    read.retain_only(frozenset())
    for message in written.finish():
        read.hear(message.payload.encode())
    cleared = {message.topic for message in read.finish() if not message.topic.startswith("retained/")}
    assert cleared == {f"my/{name}" for name in names if name.isprintable()}


def test_a_rule_that_is_gone_becomes_unavailable_before_it_is_forgotten():
    sent = [(each.topic, each.payload, each.retain) for each in clearing({"rule/near/availability", "rule/near/state"})]
    assert sent == [
        ("rule/near/availability", "offline", False),
        ("rule/near/availability", "", True),
        ("rule/near/state", "", True),
    ]


def test_the_settings_of_a_rule_that_is_gone_are_forgotten():
    written = RetainedList("retained/it", "it")
    written.retain_only(frozenset({"rule/near/settings", "rule/near/whatever"}))
    read = RetainedList("retained/it", "it")
    read.retain_only(frozenset())
    for message in written.finish():
        read.hear(message.payload.encode())
    cleared = read.finish()
    assert Message(topic="rule/near/settings", payload="", qos=1, retain=True) in cleared
    assert not any("whatever" in message.topic for message in cleared)


def test_of_more_rules_than_a_list_has_room_for_the_rest_is_left_out_and_the_list_is_read_back():
    listed = RetainedList("retained/it", "it")
    listed.retain_only(topics(*(f"rule-{number}" for number in range(20_000))))
    (message,) = listed.finish()
    assert 150_000 < len(message.payload.encode()) <= LIST_MAX_BYTES < PACKET_MAX - 8192
    assert len(json.loads(message.payload)) > 5000
