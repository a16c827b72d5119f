"""Real mosquittos with the example configurations: roles that stay within their bounds, and a bridge between two."""

from __future__ import annotations

import json
import re
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from stadimeter.config.plugins import DriverContext
from stadimeter.messaging.mqtt import MqttOptions, PahoMessenger
from stadimeter.messaging.mqtt_client import make_client, read_secrets
from stadimeter.messaging.protocol import RequestMessage
from stadimeter.testing.rig import ManualClock, eventually
from support.broker import HOST, BrokerAccess, MosquittoBroker
from support.command_line import typed
from support.mqtt_listener import MqttListener
from support.programs import require

# A real mosquitto takes the example configurations, and keeps readers, operators and devices within their roles.

PASSWORD = "only for this test"
DEVICE, OTHER, OPERATOR, READER = USERS = ("garage", "attic", "homeassistant", "dashboard")


@pytest.fixture
def site(request: pytest.FixtureRequest, deploy: Path, tmp_path: Path) -> Iterator[Site]:
    """Start the broker with the example's files, only moved elsewhere and to the loopback."""
    require("mosquitto", "mosquitto_passwd", "openssl")
    broker = MosquittoBroker(tmp_path)
    site = Site(broker.port, tmp_path, has_certificates=getattr(request, "param", "") == "certificates")
    acl = (deploy / "mosquitto/stadimeter.acl").read_text()
    device = acl[acl.index("user garage") : acl.index("# Operators")]
    (tmp_path / "stadimeter.acl").write_text(acl + device.replace("garage", "attic"))
    if site.has_certificates:
        make = [deploy / "mosquitto/make-certificates", tmp_path / "stadimeter", "127.0.0.1", *USERS]
        subprocess.run(make, check=True, timeout=120)
    else:
        (tmp_path / "stadimeter.passwd").touch()
        for user in USERS:
            made = ["mosquitto_passwd", "-b", str(tmp_path / "stadimeter.passwd"), user, PASSWORD]
            subprocess.run(made, check=True, timeout=120)
    conf = (deploy / "mosquitto" / ("stadimeter-tls.conf" if site.has_certificates else "stadimeter.conf")).read_text()
    broker._file.write_text(moved(conf, site))
    broker.start()
    yield site
    broker.stop()


class Site:
    """Where the broker is, and what its users log in with."""

    def __init__(self, port: int, folder: Path, *, has_certificates: bool) -> None:
        self.port = port
        self.folder = folder
        self.has_certificates = has_certificates

    def file(self, name: str) -> str:
        return str(self.folder / "stadimeter" / name)


def moved(conf: str, site: Site) -> str:
    conf, listeners = re.subn(r"(?m)^listener (1883|8883)$", f"listener {site.port} 127.0.0.1\nuser root", conf)
    conf, renamed = re.subn(r"(?m)^(\w+file) /etc/mosquitto/", rf"\1 {site.folder}/", conf)
    assert (listeners, renamed) == (1, 4 if site.has_certificates else 2)
    return conf


class Remembering:
    """A client that connects, and remembers what it heard."""

    def __init__(self, site: Site, user: str | None, password: str = PASSWORD) -> None:
        self.heard: list[tuple[str, bytes]] = []
        self.connected, self.subscribed, self.got = threading.Event(), threading.Event(), threading.Event()
        self.refusal = ""
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        if site.has_certificates and user is not None:
            self._client.tls_set(site.file("ca.crt"), site.file(f"{user}.crt"), site.file(f"{user}.key"))
        elif user is not None:
            self._client.username_pw_set(user, password)
        self._client.on_connect = self._on_connect
        self._client.on_subscribe = lambda *_: self.subscribed.set()
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", site.port)
        self._client.loop_start()
        assert self.connected.wait(120)

    def _on_connect(self, _client: object, _data: object, _flags: object, reason: object, _properties: object) -> None:
        self.refusal = "" if str(reason) == "Success" else str(reason)
        self.connected.set()

    def _on_message(self, _client: object, _data: object, message: mqtt.MQTTMessage) -> None:
        self.heard.append((message.topic, message.payload))
        self.got.set()

    def listen(self, topic: str = "stadimeter/#") -> None:
        self._client.subscribe(topic, qos=1)
        assert self.subscribed.wait(120)

    def publish(self, topic: str, payload: str) -> None:
        self._client.publish(topic, payload, qos=1).wait_for_publish(120.0)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()
        # Else it would be freed with the listeners in one circle, and its sockets perhaps before it has closed them.
        self._client.on_connect = self._client.on_subscribe = self._client.on_message = None


Connect = Callable[..., Remembering]


@pytest.fixture
def connect(site: Site) -> Iterator[Connect]:
    clients: list[Remembering] = []

    def make(user: str | None, password: str = PASSWORD) -> Remembering:
        clients.append(Remembering(site, user, password))
        return clients[-1]

    yield make
    for client in clients:
        client.close()


OWN = ("event/alarm", "availability", "response/acknowledge", "rule/near/state")


@pytest.mark.parametrize(
    ("listener", "topic", "refused", "heard"),
    [
        pytest.param(
            OPERATOR,
            "#",
            [
                (DEVICE, "stadimeter/attic/event/alarm"),
                (DEVICE, "stadimeter/attic/request/stop-outputs"),
                (DEVICE, "elsewhere"),
                (READER, "homeassistant/device/stadimeter_dashboard/config"),
                (READER, "stadimeter/dashboard/rule/near/state"),
                (OPERATOR, "homeassistant/device/stadimeter_homeassistant/config"),
                (OPERATOR, "stadimeter/homeassistant/rule/near/state"),
            ],
            [(DEVICE, "stadimeter/garage/event/alarm")],
            id="a device is heard below its own name only, and neither a reader nor an operator is one",
        ),
        pytest.param(
            DEVICE,
            "stadimeter/#",
            [
                (OPERATOR, "stadimeter/attic/request/acknowledge"),
                (READER, "stadimeter/garage/request/reset"),
                (DEVICE, "stadimeter/garage/event/alarm"),
            ],
            [(OPERATOR, "stadimeter/garage/request/acknowledge"), (DEVICE, "stadimeter/garage/rule/near/state")],
            id="a device reads its commands and what the broker keeps of its rules",
        ),
        pytest.param(
            OTHER,
            "stadimeter/#",
            [(DEVICE, "stadimeter/garage/event/alarm"), (OPERATOR, "stadimeter/garage/request/acknowledge")],
            [(OTHER, "stadimeter/attic/rule/near/state")],
            id="a device does not listen to the others",
        ),
        pytest.param(
            READER,
            "stadimeter/#",
            [
                *((OPERATOR, f"stadimeter/garage/{topic}") for topic in OWN),
                *((READER, f"stadimeter/garage/{topic}") for topic in ("request/reset", "event/alarm")),
                (DEVICE, "stadimeter/garage/snapshot"),
            ],
            [
                (OPERATOR, "stadimeter/garage/request/acknowledge"),
                (DEVICE, "stadimeter/garage/response/acknowledge"),
                (DEVICE, "stadimeter/garage/event/alarm"),
            ],
            id="a reader hears alarms and no pictures, and nobody forges them",
        ),
    ],
)
def test_each_role_publishes_and_hears_within_its_bounds(connect, listener, topic, refused, heard):
    clients = {user: connect(user) for user in (DEVICE, OTHER, OPERATOR, READER)}
    clients[listener].listen(topic)
    for user, where in (*refused, *heard):  # what was heard last came after all that was refused
        clients[user].publish(where, "{}")
    eventually(lambda: len(clients[listener].heard) >= len(heard))
    assert clients[listener].heard == [(where, b"{}") for _, where in heard]


def test_no_one_guesses_the_client_id_by_which_a_broker_would_end_a_device_s_connection(tmp_path):
    def client_id(password: str, node: str = "garage") -> bytes:
        (tmp_path / "password").write_text(password)
        table = {"host": "127.0.0.1", "node": node, "username": node, "password_file": str(tmp_path / "password")}
        options = MqttOptions.model_validate(table)
        return make_client(options, read_secrets(options), mqtt.MQTTv5, 1.0)._client_id

    assert client_id(PASSWORD) == client_id(PASSWORD), "else its session would not be found again"
    assert len({client_id(PASSWORD), client_id("another"), client_id(PASSWORD, "attic")}) == 3
    assert re.fullmatch(rb"stadimeter-garage-[0-9a-f]{12}", client_id(PASSWORD))


@pytest.mark.parametrize("site", ["passwords", pytest.param("certificates", marks=pytest.mark.long)], indirect=True)
def test_the_program_itself_takes_commands_and_answers_within_its_role(site, connect):
    table: dict[str, Any] = {"host": "127.0.0.1", "port": site.port, "node": "garage", "protocol": "5"}
    if site.has_certificates:
        files = {name: site.file(f"garage.{name[:3]}") for name in ("crt", "key")}
        table |= {"tls": True, "ca_file": site.file("ca.crt")}
        table |= {"certificate_file": files["crt"], "key_file": files["key"]}
    else:
        (site.folder / "password").write_text(PASSWORD)
        table |= {"username": "garage", "password_file": str(site.folder / "password")}
    messenger = MqttOptions.model_validate(table).build(DriverContext(name="it", clock=ManualClock()))
    assert isinstance(messenger, PahoMessenger)
    requests: list[RequestMessage] = []
    messenger.listen(["request/acknowledge"], ["request/acknowledge"], requests.append)
    operator = connect("homeassistant")
    with ExitStack() as closing:
        closing.callback(messenger.close)
        messenger.open()
        eventually(lambda: not messenger.trouble() and not messenger.undelivered())
        eventually(lambda: operator.publish("stadimeter/garage/request/acknowledge", "{}") or requests)
        operator.listen()
        messenger.respond(requests[0], "response/acknowledge", b"done")
        eventually(lambda: ("stadimeter/garage/response/acknowledge", b"done") in operator.heard)
        assert (messenger.deafness(), messenger.given_up, requests[0].refusal) == ("", 0, None)


def test_an_appliance_announces_itself_only_and_hears_that_home_assistant_has_started(connect):
    home, garage = connect("homeassistant"), connect("garage")
    home.listen("homeassistant/device/#")
    garage.listen("homeassistant/#")
    garage.publish("homeassistant/device/stadimeter_attic/config", "forged")
    garage.publish("homeassistant/status", "forged")
    garage.publish("homeassistant/device/stadimeter_garage/config", "real")
    assert home.got.wait(120)
    assert home.heard == [("homeassistant/device/stadimeter_garage/config", b"real")]
    home.publish("homeassistant/status", "online")
    eventually(lambda: len(garage.heard) == 2)  # its own announcement, and the start: nothing that was forged
    assert garage.heard == [
        ("homeassistant/device/stadimeter_garage/config", b"real"),
        ("homeassistant/status", b"online"),
    ]


@pytest.mark.parametrize(("user", "password"), [(None, ""), ("garage", "wrong"), ("stranger", PASSWORD)])
def test_who_has_no_password_is_refused(connect, user, password):
    assert connect(user, password).refusal == "Not authorized"


@pytest.mark.long
@pytest.mark.parametrize("site", ["certificates"], indirect=True)
def test_who_has_no_certificate_of_the_authority_is_refused(site, deploy):
    elsewhere = site.folder / "elsewhere"
    subprocess.run([deploy / "mosquitto/make-certificates", elsewhere, "127.0.0.1", "garage"], check=True, timeout=120)
    base: dict[str, Any] = {"host": "127.0.0.1", "port": site.port, "node": "garage", "tls": True, "protocol": "5"}
    base |= {"ca_file": site.file("ca.crt")}
    pair = {"certificate_file": str(elsewhere / "garage.crt"), "key_file": str(elsewhere / "garage.key")}
    for table in (base, base | pair):
        assert MqttOptions.model_validate(table).reach() != ""
    mine = {"certificate_file": site.file("garage.crt"), "key_file": site.file("garage.key")}
    assert MqttOptions.model_validate(base | mine).reach() == ""


@pytest.mark.parametrize("site", ["certificates"], indirect=True)
def test_more_users_get_certificates_later_and_the_first_keep_theirs(site, deploy):
    before = Path(site.file("garage.crt")).read_bytes(), Path(site.file("ca.crt")).read_bytes()
    make = [deploy / "mosquitto/make-certificates", site.folder / "stadimeter", "127.0.0.1", "garage", "cellar"]
    subprocess.run(make, check=True, timeout=120)
    assert (Path(site.file("garage.crt")).read_bytes(), Path(site.file("ca.crt")).read_bytes()) == before
    client = Remembering(site, "cellar")
    client.close()
    assert client.refusal == ""
    wrong = subprocess.run(
        [*make[:2], "127.0.0.1", "../garage"], capture_output=True, text=True, timeout=120, check=False
    )
    assert (wrong.returncode, "is no user name" in wrong.stderr) == (2, True)


# Two real mosquittos with the example bridge between them: a site, and a centre that sees its devices.

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
def bridged_site(tmp_path: Path, deploy: Path, centre: MosquittoBroker, closing: ExitStack) -> MosquittoBroker:
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
def device(bridged_site: MosquittoBroker) -> Iterator[Client]:
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    client.connect(HOST, bridged_site.port)
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
