"""What a broker keeps of a run is cleared when it is published no more: by real brokers, over real links."""

from __future__ import annotations

import pytest

from stadimeter.core.message import Message, clearing
from stadimeter.messaging.mqtt import PahoMessenger
from stadimeter.testing.rig import eventually
from support.mqtt_listener import MqttListener

BASE = "stadimeter/it"


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
    settings = "rule/near/settings"
    ran(make_messenger(broker.port, protocol=protocol), "near", "far", also=(settings, "door/alert")).close()
    ran(make_messenger(broker.port, protocol=protocol), "nearer", "far")
    witness.wait_for(f"{BASE}/rule/near/state", "")
    witness.wait_for(f"{BASE}/{settings}", "")
    witness.wait_for_payloads(f"{BASE}/rule/far/state", ["far", "far"])  # the newest that is kept
    # What a rule sends to a topic of the user's own is the user's: nothing says that no other program sends it, too.
    assert kept(witness).keys() == {"availability", "rule/nearer/state", "rule/far/state", "door/alert"}


@pytest.mark.long
def test_a_run_that_was_killed_leaves_nothing_either(broker, make_messenger, listen, lay_tunnel):
    tunnel = lay_tunnel(broker.port)
    ran(make_messenger(tunnel.port), "near")
    tunnel.cut()  # it never comes back, and says no goodbye
    witness = listen(broker.port)
    ran(make_messenger(broker.port), "far")
    witness.wait_for(f"{BASE}/rule/near/state", "")


@pytest.mark.long
def test_a_rule_that_was_renamed_while_the_broker_was_away_is_forgotten_when_it_is_back(
    broker, make_messenger, listen, lay_tunnel
):
    tunnel = lay_tunnel(broker.port)
    messenger = ran(make_messenger(tunnel.port), "near")
    witness = listen(broker.port)
    tunnel.cut()
    eventually(messenger.trouble)
    messenger.retain_only(topics("far"))
    tunnel.mend()
    witness.wait_for(f"{BASE}/rule/near/state", "")


def test_what_is_kept_is_compared_though_the_broker_answers_before_the_run_knows_what_it_publishes(
    broker, make_messenger, listen
):
    ran(make_messenger(broker.port), "near").close()
    messenger = make_messenger(broker.port)
    messenger.open()
    eventually(lambda: not messenger.trouble())
    witness = listen(broker.port)
    messenger.retain_only(topics("far"))
    witness.wait_for(f"{BASE}/rule/near/state", "")


def test_what_others_keep_there_is_left_alone(broker, make_messenger, listen):
    writer = make_messenger(broker.port, node="writer", base_topic=BASE)
    writer.open()
    others = ["up", "rule/a/b/state", "rule/near/whatever", "event/alarm", "target/ball/state"]
    for topic in (*others, "rule/gone/state"):
        writer.publish(Message(topic=topic, payload="x", qos=1, retain=True))
    eventually(lambda: not writer.undelivered() and not writer.trouble())
    witness = listen(broker.port)
    ran(make_messenger(broker.port), "near")
    witness.wait_for(f"{BASE}/rule/gone/state", "")
    assert set(others) <= kept(witness).keys()


def test_a_login_that_may_write_only_publishes_as_before(broker, start_broker, make_messenger, listen):
    strict = start_broker(acl=f"topic write {BASE}/#\n")
    messenger = ran(make_messenger(strict.port), "near")
    assert (messenger.trouble(), messenger.given_up) == ("", 0)


def test_a_rule_that_is_gone_becomes_unavailable_before_it_is_forgotten():
    sent = [(each.topic, each.payload, each.retain) for each in clearing({"rule/near/availability", "rule/near/state"})]
    assert sent == [
        ("rule/near/availability", "offline", False),
        ("rule/near/availability", "", True),
        ("rule/near/state", "", True),
    ]
