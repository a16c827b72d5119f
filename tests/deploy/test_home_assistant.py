"""A real Home Assistant takes what a run announces, shows what it publishes, and knows our blueprints.

It needs Python 3.13.2, so it is installed into a bare root of Debian 13: by root, with debootstrap and a network.
``HOME_ASSISTANT_ROOT`` is the folder of such a root that was made before, which is used as it is.
"""

from __future__ import annotations

import json
import os
import shutil
import ssl
import subprocess
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt import publish

import stadimeter
from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.home_assistant import Announcement
from stadimeter.testing.rig import eventually
from support.broker import HOST, MosquittoBroker
from support.debian_root import DebianRoot, make_root, why_no_root
from support.every_rule import ORDERS, announced, every_rule
from support.programs import why_missing
from support.simulated_run import SIMULATED_BALL

VERSION = "2026.2.3"
WHY_NOT = why_no_root() or why_missing("mosquitto")
pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT or "it can"),
]

PROGRAM = Path(__file__).parents[1] / "support/in_home_assistant.py"
BLUEPRINTS = Path(__file__).parents[2] / "deploy/homeassistant"
PYTHON = "/opt/ha/bin/python"
INSTALL = (
    "env",
    "SSL_CERT_FILE=/root/ca.crt",
    "PIP_CERT=/root/ca.crt",
    "UV_HTTP_TIMEOUT=300",
    "PIP_DEFAULT_TIMEOUT=300",
)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> DebianRoot:
    """Return a root with Home Assistant."""
    made = os.environ.get("HOME_ASSISTANT_ROOT", "")
    found = DebianRoot(Path(made)) if made else _make(tmp_path_factory.mktemp("trixie"))
    shutil.copy(PROGRAM, found / "/root")
    return found


def _make(folder: Path) -> DebianRoot:
    architecture = subprocess.run(["dpkg", "--print-architecture"], check=True, capture_output=True, text=True)
    root = make_root(folder, "trixie", architecture.stdout.strip())
    shutil.copy("/etc/resolv.conf", root / "/etc/resolv.conf")
    shutil.copy(ssl.get_default_verify_paths().cafile or "/etc/ssl/certs/ca-certificates.crt", root / "/root/ca.crt")
    # The version that it asks for exists as source only, and there is no compiler in the root.
    (root / "/root/override.txt").write_text("lru-dict>=1.4\n")
    if root.try_to("apt-get", "install", "--yes", "--no-install-recommends", "python3-venv").returncode:
        pytest.skip("Debian's packages cannot be had")
    root.run("python3", "-m", "venv", "/opt/ha")
    if root.try_to(*INSTALL, "/opt/ha/bin/pip", "install", "uv").returncode:
        pytest.skip("PyPI cannot be reached")
    packages = (f"homeassistant=={VERSION}", "paho-mqtt==2.1.0")
    root.run(
        *INSTALL, "/opt/ha/bin/uv", "pip", "install", "--python", PYTHON, "--override", "/root/override.txt", *packages
    )
    return root


class HomeAssistant:
    """A Home Assistant that runs in the root, connected to a broker of ours; they share the loopback interface."""

    def __init__(self, root: DebianRoot, folder: str, port: int) -> None:
        command = root.command(PYTHON, f"/root/{PROGRAM.name}", folder, str(port))
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, what: str, **more: Any) -> Any:
        """Have it do something, and return its answer."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"do": what, **more}) + "\n")
        self._process.stdin.flush()
        reply = json.loads(self._process.stdout.readline())
        assert "error" not in reply, reply["error"]
        return reply["answer"]

    def states(self) -> dict[str, Any]:
        """Return every entity by its unique id, without the device's part of it."""
        return {key.partition("_")[2].partition("_")[2]: each for key, each in self.ask("states").items()}

    def complaints(self) -> list[str]:
        """Return what it had to say about what came over MQTT."""
        return [
            line
            for line in self.ask("warnings")
            if "mqtt" in line.partition(" ")[0] or "setup" in line.partition(" ")[0]
        ]

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(120)
        assert self._process.stdout is not None
        self._process.stdout.close()


@pytest.fixture
def broker(tmp_path: Path, closing: ExitStack) -> MosquittoBroker:
    broker = MosquittoBroker(tmp_path)
    broker.start()
    closing.callback(broker.stop)
    return broker


@pytest.fixture
def home(root: DebianRoot, broker: MosquittoBroker, tmp_path: Path, closing: ExitStack) -> HomeAssistant:
    home = HomeAssistant(root, f"/tmp/{tmp_path.name}", broker.port)  # noqa: S108 - in the root
    closing.callback(home.close)
    return home


def send(broker: MosquittoBroker, announcement: Announcement) -> None:
    message = announcement.message()
    publish.single(message.topic, message.payload, 1, retain=True, hostname=HOST, port=broker.port)


@pytest.mark.parametrize("orders", [frozenset(), ORDERS])
def test_every_entity_of_every_kind_of_rule_is_accepted(orders, home, broker, tmp_path):
    announcement = announced(every_rule(tmp_path), orders=orders)
    send(broker, announcement)
    eventually(lambda: home.states().keys() == announcement.components.keys())
    assert home.complaints() == []
    found = home.states()
    assert {key for key, each in found.items() if each["is_disabled"]} == {
        "frame_rate", "latency", "temperature", "undelivered",
    }  # fmt: skip
    for key, component in announcement.components.items():
        assert found[key]["entity_id"] == component["default_entity_id"]
        assert found[key]["name"] == component["name"]


RUN = (
    SIMULATED_BALL
    + """
[messenger]
driver = "mqtt"
port = {port}
node = "it"
[rules.near]
severity = "alarm"
when = {{ below = "1.6 m" }}
off_delay = "0 s"
{more}
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
"""
)


class Run:
    """A whole run in real time, in a thread."""

    def __init__(self, folder: Path, port: int, more: str = "") -> None:
        import threading

        path = folder / "run.toml"
        path.write_text(RUN.format(port=port, more=more))
        self.loop = Loop(build(load_configuration(path)))
        self._thread = threading.Thread(target=self.loop.run, daemon=True)
        self._thread.start()

    @property
    def world(self) -> Any:
        return self.loop.parts.world

    def close(self) -> None:
        self.loop.end("the test is over")
        self._thread.join(120)


def test_home_assistant_shows_what_a_run_publishes_from_its_start_to_its_end(home, broker, tmp_path, closing):
    run = Run(tmp_path, broker.port)
    closing.callback(run.close)

    def shows(key: str) -> Callable[[str], bool]:
        return lambda state: home.states().get(key, {}).get("state") == state

    eventually(lambda: shows("presence_ball")("on"))
    eventually(lambda: shows("rule_near")("off"))
    states = home.states()
    assert float(states["distance_ball"]["state"]) == pytest.approx(2.0, abs=0.1)
    assert states["status_ball"]["state"] == "tracking"
    assert "is not below" in states["rule_near"]["attributes"]["reason"] or states["rule_near"]["attributes"]["reason"]

    eventually(lambda: home.states()["software"]["attributes"]["installed_version"] == stadimeter.__version__)
    publish.single("stadimeter/latest_version", "99.0", 1, retain=True, hostname=HOST, port=broker.port)
    eventually(lambda: shows("software")("on"))

    run.world.place_target(1.3, 0.0)
    eventually(lambda: shows("rule_near")("on"))
    eventually(lambda: home.states()["alarm"]["attributes"].get("event_type") == "raised")
    assert home.states()["alarm"]["attributes"]["rule"] == "near"

    run.world.toggle("hide-target")
    eventually(lambda: shows("presence_ball")("off"))
    eventually(lambda: shows("distance_ball")("unknown"))
    run.world.toggle("hide-target")
    run.world.place_target(2.0, 0.0)
    eventually(lambda: shows("rule_near")("off"))
    run.world.toggle("hide-target")
    eventually(lambda: shows("rule_near")("unavailable"))

    run.close()
    eventually(lambda: {each["state"] for each in home.states().values() if not each["is_disabled"]} == {"unavailable"})
    assert home.complaints() == []


def test_a_rule_that_is_renamed_goes_from_home_assistant(home, broker, tmp_path, closing):
    run = Run(tmp_path, broker.port, '[rules.far]\nwhen = { above = "3 m" }')
    eventually(lambda: "rule_far" in home.states())
    run.close()
    later = Run(tmp_path, broker.port, '[rules.further]\nwhen = { above = "3 m" }')
    closing.callback(later.close)
    eventually(lambda: "rule_further" in home.states())
    eventually(lambda: "rule_far" not in home.states())
    assert "rule_near" in home.states()
    assert home.complaints() == []


def test_a_press_of_a_button_is_an_order_in_json(home, broker, tmp_path, closing):
    from support.mqtt_listener import MqttListener

    send(broker, announced(every_rule(tmp_path), orders=ORDERS))
    for topic in ("availability", "rule/near/availability"):
        publish.single(f"stadimeter/Dock-3/{topic}", "online", 1, retain=True, hostname=HOST, port=broker.port)
    eventually(lambda: home.states().get("acknowledge_near", {}).get("state") == "unknown")
    listener = closing.enter_context(MqttListener(broker.port))
    states = home.states()
    pressed = {"entity_id": states["acknowledge_near"]["entity_id"]}
    home.ask("call", domain="button", service="press", data=pressed)
    assert json.loads(listener.wait_for("stadimeter/Dock-3/request/acknowledge").payload) == {"rule": "near"}
    entity = states["threshold_time_to_contact.below_near"]["entity_id"]
    home.ask("call", domain="number", service="set_value", data={"entity_id": entity, "value": 1.5})
    order = json.loads(listener.wait_for("stadimeter/Dock-3/request/set-threshold").payload)
    assert order == {"rule": "near", "key": "time_to_contact.below", "value": 1.5}
    entity = states["in_service_near"]["entity_id"]
    home.ask("call", domain="switch", service="turn_off", data={"entity_id": entity})
    order = json.loads(listener.wait_for("stadimeter/Dock-3/request/in-service").payload)
    assert order == {"rule": "near", "value": False}


def test_the_blueprints_are_automations(home):
    files = sorted(BLUEPRINTS.glob("*.yaml"))
    assert len(files) == 3
    for file in files:
        assert home.ask("blueprint", text=file.read_text())["name"].startswith("Stadimeter: ")
