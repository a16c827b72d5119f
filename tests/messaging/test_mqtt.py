"""The messenger against a real broker with a real subscriber."""

from __future__ import annotations

import pytest

from stadimeter.core.message import Message
from stadimeter.errors import ConfigError, DeviceOpenError
from stadimeter.messaging.mqtt import PahoMessenger
from stadimeter.testing.rig import eventually
from support.broker import free_port

BASE = "stadimeter/it"
AVAILABILITY = f"{BASE}/availability"
STATE = Message(topic="target/ball/state", payload='{"v":1}', qos=0, retain=True, expires_s=10)


def connected(messenger: PahoMessenger) -> PahoMessenger:
    messenger.open()
    eventually(lambda: not messenger.trouble())
    return messenger


def alert(payload: str) -> Message:
    return Message(topic="event/alarm", payload=payload, qos=1)


def test_it_is_announced_online_then_offline(broker, make_messenger, listen):
    listener = listen(broker.port)
    messenger = connected(make_messenger(broker.port))
    assert listener.wait_for(AVAILABILITY, "online").qos == 1
    messenger.close()
    listener.wait_for_payloads(AVAILABILITY, ["online", "offline"])


def test_a_link_that_breaks_makes_the_broker_announce_us_offline(broker, make_messenger, listen, lay_tunnel):
    listener = listen(broker.port)
    tunnel = lay_tunnel(broker.port)
    connected(make_messenger(tunnel.port, protocol="3.1.1"))
    listener.wait_for(AVAILABILITY, "online")
    tunnel.cut()
    listener.wait_for_payloads(AVAILABILITY, ["online", "offline"])
    assert listen(broker.port).wait_for(AVAILABILITY).payload == "offline"
    tunnel.mend()
    eventually(lambda: listener.payloads(AVAILABILITY)[2:3] == ["online"])  # and again if the first was not confirmed


def test_a_short_break_is_not_announced_with_mqtt_5(broker, make_messenger, listen, lay_tunnel):
    listener = listen(broker.port)
    tunnel = lay_tunnel(broker.port)
    messenger = connected(make_messenger(tunnel.port, protocol="5"))
    listener.wait_for(AVAILABILITY, "online")
    tunnel.cut()
    eventually(messenger.trouble)
    tunnel.mend()
    eventually(lambda: len(listener.payloads(AVAILABILITY)) > 1)  # three if the first was not confirmed before the cut
    assert set(listener.payloads(AVAILABILITY)) == {"online"}


@pytest.mark.long
def test_a_long_break_is_announced_with_mqtt_5(broker, make_messenger, listen, lay_tunnel):
    listener = listen(broker.port)
    tunnel = lay_tunnel(broker.port)
    connected(make_messenger(tunnel.port, protocol="5"))
    listener.wait_for(AVAILABILITY, "online")
    tunnel.cut()
    listener.wait_for_payloads(AVAILABILITY, ["online", "offline"])


def test_alerts_are_sent_at_least_once_and_never_kept(broker, make_messenger, listen):
    listener = listen(broker.port)
    messenger = connected(make_messenger(broker.port))
    messenger.publish(alert("raised"))
    assert listener.wait_for(f"{BASE}/event/alarm", "raised").qos == 1
    late = listen(broker.port)
    messenger.publish(alert("cleared"))
    late.wait_for_payloads(f"{BASE}/event/alarm", ["cleared"])


def test_a_state_is_kept_with_its_expiry_by_mqtt_5(broker, make_messenger, listen):
    listener = listen(broker.port, is_v5=True)
    connected(make_messenger(broker.port)).publish(STATE)
    heard = listener.wait_for(f"{BASE}/{STATE.topic}", STATE.payload)
    assert (heard.qos, heard.expires_s) == (0, 10)
    late = listen(broker.port, is_v5=True).wait_for(f"{BASE}/{STATE.topic}")
    assert late.is_retained
    assert late.expires_s is not None
    assert 0 < late.expires_s <= 10


def test_a_state_that_expires_is_not_kept_by_mqtt_311_where_it_would_never_expire(broker, make_messenger, listen):
    witness = listen(broker.port)
    messenger = connected(make_messenger(broker.port, protocol="3.1.1"))
    messenger.publish(STATE)
    messenger.publish(Message(topic="rule/near/state", payload="kept", qos=1, retain=True))
    witness.wait_for(f"{BASE}/{STATE.topic}")
    witness.wait_for(f"{BASE}/rule/near/state")
    late = listen(broker.port)
    assert late.wait_for(f"{BASE}/rule/near/state").is_retained
    messenger.publish(alert("a sign that all that was kept has come"))
    late.wait_for(f"{BASE}/event/alarm")
    assert late.payloads(f"{BASE}/{STATE.topic}") == []


@pytest.mark.long
def test_a_link_that_takes_nothing_any_more_holds_neither_publishing_nor_memory(broker, make_messenger, lay_tunnel):
    tunnel = lay_tunnel(broker.port)
    messenger = connected(make_messenger(tunnel.port))
    tunnel.clog()
    for _ in range(4000):
        messenger.publish(Message(topic="target/ball/state", payload="x" * 10_000))
    assert messenger.trouble() == ""
    assert messenger.dropped > 0


@pytest.mark.long
def test_closing_over_a_link_that_takes_nothing_leaves_the_last_word_to_the_broker(
    broker, make_messenger, listen, lay_tunnel
):
    listener = listen(broker.port)
    tunnel = lay_tunnel(broker.port)
    messenger = connected(make_messenger(tunnel.port, protocol="3.1.1"))
    listener.wait_for(AVAILABILITY, "online")
    tunnel.clog()
    messenger.publish(alert("never acknowledged"))
    messenger.close()
    assert messenger.undelivered() == (alert("never acknowledged"),)
    tunnel.cut()
    listener.wait_for_payloads(AVAILABILITY, ["online", "offline"])


def test_a_wrong_password_is_said_in_words_and_not_repeated_in_them(start_broker, make_messenger, tmp_path):
    broker = start_broker(username="pi", password="open sesame")
    password_file = tmp_path / "password"
    password_file.write_text("open barley\n")
    messenger = make_messenger(broker.port, username="pi", password_file=str(password_file))
    messenger.open()
    words = eventually(lambda: "login" in messenger.trouble() and messenger.trouble())
    assert "refused the login of 'pi'" in words
    assert "check username and password_file" in words
    assert "barley" not in words


@pytest.mark.parametrize(
    ("text", "expected"),
    [(None, "no such file"), ("", "no password on its first line"), ("\nsecond line", "no password on its first line")],
)
def test_a_password_file_of_no_use_is_an_error_at_once(text, expected, make_messenger, tmp_path):
    password_file = tmp_path / "password"
    if text is not None:
        password_file.write_text(text)
    messenger = make_messenger(free_port(), username="pi", password_file=str(password_file))
    with pytest.raises(DeviceOpenError, match=expected):
        messenger.open()


def test_a_message_that_the_access_list_forbids_is_said_in_words(broker, start_broker, make_messenger):
    strict = start_broker(acl=f"topic readwrite {AVAILABILITY}\n")
    messenger = connected(make_messenger(strict.port))
    messenger.publish(alert("raised"))
    eventually(lambda: "check the broker's access list" in messenger.trouble())
    eventually(lambda: (messenger.given_up, messenger.undelivered()) == (1, ()))


def test_two_programs_with_one_name_are_said_in_words(broker, make_messenger):
    first = connected(make_messenger(broker.port))
    connected(make_messenger(broker.port))
    eventually(lambda: "does another program use the client id 'stadimeter-it'?" in first.trouble())


def test_a_topic_with_a_wildcard_is_refused(broker, make_messenger):
    messenger = connected(make_messenger(broker.port))
    for topic in ("", "rule/+/state", "#"):
        with pytest.raises(ConfigError, match="not a topic"):
            messenger.publish(Message(topic=topic, payload="x"))
    assert messenger.trouble() == ""
