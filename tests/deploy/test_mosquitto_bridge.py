"""Two real mosquittos with the example bridge between them: a site, and a centre that sees its devices."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from support.broker import HOST, BrokerAccess, MosquittoBroker
from support.command_line import typed
from support.mqtt_listener import MqttListener

PASSWORD = "only for this test"
WAIT_S = 120.0
NAME = "stadimeter/hall/press"


def access_list(conf: str) -> str:
    """Return the lines for the access list that the example shows, which everybody else may read."""
    lines = re.findall(r"(?m)^#   ((?:user|topic) .+)$", conf)
    assert len(lines) == 3
    return "\n".join([*lines, "pattern read #", ""])


@pytest.fixture
def closing() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def centre(tmp_path: Path, deploy: Path, closing: ExitStack) -> MosquittoBroker:
    acl = access_list((deploy / "mosquitto" / "bridge.conf").read_text())
    broker = MosquittoBroker(tmp_path, BrokerAccess(username="hall", password=PASSWORD, acl=acl))
    broker.start()
    closing.callback(broker.stop)
    return broker


@pytest.fixture
def site(tmp_path: Path, deploy: Path, centre: MosquittoBroker, closing: ExitStack) -> MosquittoBroker:
    """Start a site's broker with the example, only with another address and without TLS."""
    conf, changed = re.subn(
        r"(?m)^address .+$", f"address {HOST}:{centre.port}", (deploy / "mosquitto" / "bridge.conf").read_text()
    )
    conf, with_password = re.subn(r"(?m)^remote_password .+$", f"remote_password {PASSWORD}", conf)
    conf, without_tls = re.subn(r"(?m)^bridge_cafile .+\n", "", conf)
    assert (changed, with_password, without_tls) == (1, 1, 1)
    broker = MosquittoBroker(tmp_path)
    broker._file.write_text(broker._file.read_text() + conf)
    broker.start()
    closing.callback(broker.stop)
    return broker


@pytest.fixture
def device(site: MosquittoBroker) -> Iterator[Client]:
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    client.connect(HOST, site.port)
    client.loop_start()
    yield client
    client.disconnect()
    client.loop_stop()


def say(device: Client, topic: str, payload: object, qos: int = 1, *, retain: bool = False, expires_s: int = 0) -> None:
    properties = Properties(PacketTypes.PUBLISH)
    if expires_s:
        properties.MessageExpiryInterval = expires_s
    text = payload if isinstance(payload, str) else json.dumps(payload)
    device.publish(f"{NAME}/{topic}", text, qos, retain, properties).wait_for_publish(WAIT_S)


def test_the_centre_sees_the_devices_of_a_site_and_for_how_long_their_states_are_valid(centre, device):
    say(device, "availability", "online", retain=True)
    say(device, "info", {"version": "0.1.0"}, retain=True)
    with MqttListener(centre.port, ("hall", PASSWORD), is_v5=True) as listener:
        listener.wait_for(f"{NAME}/availability", "online")  # the bridge stands
        say(device, "target/ball/state", {"seq": 1, "status": "tracking"}, 0, retain=True, expires_s=10)
        say(device, "rule/near/state", {"active": True, "severity": "alarm"}, retain=True)
        say(device, "event/alarm", {"id": "1", "event_type": "raised", "rule": "near"})
        say(device, "door/alert", "a message of the user's own")
        listener.wait_for(f"{NAME}/event/alarm")
        state = listener.wait_for(f"{NAME}/target/ball/state")
        assert state.expires_s is not None
        assert state.expires_s <= 10
        assert not listener.payloads(f"{NAME}/door/alert")
    with MqttListener(centre.port, ("hall", PASSWORD), is_v5=True) as later:
        kept = later.wait_for(f"{NAME}/rule/near/state")
        assert kept.is_retained
        state = later.wait_for(f"{NAME}/target/ball/state")
        assert state.is_retained
        assert state.expires_s is not None
        assert state.expires_s <= 10


def test_a_request_of_the_centre_reaches_a_device_and_its_answer_comes_back(centre, device, tmp_path):
    (tmp_path / "password").write_text(PASSWORD)

    def answer(client: Client, _data: object, message: object) -> None:
        request = json.loads(message.payload)  # type: ignore[attr-defined]
        done = {"status": "ok", "data": None, "error": None, "transaction": request["transaction"]}
        client.publish(f"{NAME}/response/acknowledge", json.dumps(done), 1)

    device.on_message = answer
    device.subscribe(f"{NAME}/request/acknowledge", 1)
    with MqttListener(centre.port, ("hall", PASSWORD)) as listener:
        say(device, "availability", "online", retain=True)
        listener.wait_for(f"{NAME}/availability", "online")
    login = 'username = "hall"\npassword_file = "password"\n'
    (tmp_path / "centre.toml").write_text(
        f'[messenger]\ndriver = "mqtt"\nhost = "{HOST}"\nport = {centre.port}\n{login}'
    )
    done = typed("fleet", tmp_path / "centre.toml", "--acknowledge", "hall/press/near", "--wait", "100 s")
    assert (done.returncode, done.stdout) == (0, "acknowledged: stadimeter/hall/press/near\n"), done.stderr
