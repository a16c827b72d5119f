"""A real mosquitto takes the example configuration, and keeps appliances out of each other's topics."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

PASSWORD = "only for this test"


@pytest.fixture
def broker_port(deploy: Path, tmp_path: Path) -> Iterator[int]:
    """Start the broker with the example's files, only moved elsewhere and to the loopback."""
    mosquitto = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if mosquitto is None or shutil.which("mosquitto_passwd") is None:
        pytest.skip("mosquitto is not installed")
    port = free_port()
    conf = (deploy / "mosquitto.conf").read_text()
    conf, moved = re.subn(r"(?m)^listener 1883$", f"listener {port} 127.0.0.1\nuser root", conf)
    conf, renamed = re.subn(r"(?m)^(\w+_file) /etc/mosquitto/", rf"\1 {tmp_path}/", conf)
    assert (moved, renamed) == (1, 2)
    (tmp_path / "mosquitto.conf").write_text(conf)
    shutil.copy(deploy / "mosquitto.acl", tmp_path / "stadimeter.acl")
    passwords = tmp_path / "stadimeter.passwd"
    passwords.touch()
    for user in ("garage", "attic", "homeassistant"):
        subprocess.run(["mosquitto_passwd", "-b", str(passwords), user, PASSWORD], check=True, timeout=120)
    log = tmp_path / "log"
    with log.open("w") as output:
        broker = subprocess.Popen([mosquitto, "-c", str(tmp_path / "mosquitto.conf")], stdout=output, stderr=output)
    try:
        wait_for_port(port, broker, log)
        yield port
    finally:
        broker.terminate()
        broker.wait(timeout=120)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_for_port(port: int, broker: subprocess.Popen[bytes], log: Path) -> None:
    deadline_s = time.monotonic() + 10.0
    while time.monotonic() < deadline_s:
        assert broker.poll() is None, log.read_text()
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except ConnectionRefusedError:
            time.sleep(0.02)
        else:
            return
    raise AssertionError(log.read_text())


class Client:
    """A client that connects, and remembers what it heard."""

    def __init__(self, port: int, user: str | None, password: str = PASSWORD) -> None:
        self.heard: list[tuple[str, bytes]] = []
        self.connected, self.subscribed, self.got = threading.Event(), threading.Event(), threading.Event()
        self.refusal = ""
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        if user is not None:
            self._client.username_pw_set(user, password)
        self._client.on_connect = self._on_connect
        self._client.on_subscribe = lambda *_: self.subscribed.set()
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert self.connected.wait(120)

    def _on_connect(self, _client: object, _data: object, _flags: object, reason: object, _properties: object) -> None:
        self.refusal = "" if str(reason) == "Success" else str(reason)
        self.connected.set()

    def _on_message(self, _client: object, _data: object, message: mqtt.MQTTMessage) -> None:
        self.heard.append((message.topic, message.payload))
        self.got.set()

    def listen(self) -> None:
        self._client.subscribe("stadimeter/#", qos=1)
        assert self.subscribed.wait(120)

    def publish(self, topic: str, payload: str) -> None:
        self._client.publish(topic, payload, qos=1).wait_for_publish(10.0)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@pytest.fixture
def connect(broker_port: int) -> Iterator[Callable[..., Client]]:
    clients: list[Client] = []

    def make(user: str | None, password: str = PASSWORD) -> Client:
        clients.append(Client(broker_port, user, password))
        return clients[-1]

    yield make
    for client in clients:
        client.close()


def test_an_appliance_is_heard_below_its_own_name_and_nowhere_else(connect: Callable[..., Client]) -> None:
    listener, garage, attic = connect("homeassistant"), connect("garage"), connect("attic")
    listener.listen()
    attic.listen()
    garage.publish("stadimeter/attic/event/alarm", "forged")
    garage.publish("elsewhere", "noise")
    garage.publish("stadimeter/garage/event/alarm", "real")
    assert listener.got.wait(120)
    assert listener.heard == [("stadimeter/garage/event/alarm", b"real")]
    attic.publish("stadimeter/attic/event/alarm", "what it should have heard came before this is acknowledged")
    assert attic.heard == [], "an appliance does not listen to the others"


def test_an_appliance_reads_nothing_but_its_own_list_of_what_the_broker_keeps(connect: Callable[..., Client]) -> None:
    garage, attic = connect("garage"), connect("attic")
    garage.listen()
    attic.listen()
    garage.publish("stadimeter/garage/event/alarm", "raised")
    attic.publish("stadimeter/attic/retained/attic/0", "[]")
    garage.publish("stadimeter/garage/retained/garage/0", "[]")
    assert garage.got.wait(120)
    assert garage.heard == [("stadimeter/garage/retained/garage/0", b"[]")]
    assert attic.got.wait(120)
    assert attic.heard == [("stadimeter/attic/retained/attic/0", b"[]")]


@pytest.mark.parametrize(("user", "password"), [(None, ""), ("garage", "wrong"), ("stranger", PASSWORD)])
def test_who_has_no_password_is_refused(connect: Callable[..., Client], user: str | None, password: str) -> None:
    assert connect(user, password).refusal == "Not authorized"
