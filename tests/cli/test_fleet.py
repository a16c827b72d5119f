"""The command ``fleet`` at a real broker."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from rich.console import Console

from stadimeter.cli import fleet
from stadimeter.cli.fleet import STALE_S, Fleet, FleetScreen
from stadimeter.messaging.protocol import Received
from stadimeter.testing.rig import eventually
from support.broker import HOST, MosquittoBroker, free_port
from support.command_line import Typed, typed
from support.simulated_run import SIMULATED_BALL
from support.terminal import Terminal

WAIT_S = 120.0
FOLDER = tempfile.TemporaryDirectory()
LISTEN = "0.3 s"  # what has not arrived by then is looked for again
NOON = "2026-06-01T12:00:00.000+00:00"

STANDING_ALARM = """
[rules.near]
when = { below = "3 m" }
on_delay = "0 s"
severity = "alarm"
ack = "required"
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""


@pytest.fixture(autouse=True)
def patience_with_the_broker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "CONNECT_S", WAIT_S)


@pytest.fixture
def broker(tmp_path: Path, closing: ExitStack) -> MosquittoBroker:
    made = MosquittoBroker(tmp_path)
    made.start()
    closing.callback(made.stop)
    return made


@pytest.fixture
def device(broker: MosquittoBroker) -> Iterator[Client]:
    with client_at(broker.port) as client:
        yield client


@contextmanager
def client_at(port: int) -> Iterator[Client]:
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv311)
    client.connect(HOST, port)
    client.loop_start()
    try:
        yield client
    finally:
        client.disconnect()
        client.loop_stop()


def say(client: Client, topic: str, payload: object, *, retain: bool = True) -> None:
    text = payload if isinstance(payload, str) else json.dumps(payload)
    client.publish(f"stadimeter/{topic}", text, 1, retain).wait_for_publish(WAIT_S)


@contextmanager
def living(device: Client, *names: str) -> Iterator[None]:
    """Have devices say what they measure, as long as the context lasts."""
    ending = threading.Event()

    def live() -> None:
        sequence = 0
        while not ending.wait(0.05):
            for name in names:
                state = {"seq": sequence, "status": "tracking", "distance_m": 1.482, "sigma_m": 0.021}
                device.publish(f"stadimeter/{name}/target/ball/state", json.dumps(state))
            sequence += 1

    for name in names:
        say(device, f"{name}/availability", "online")
    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


def broker_file(port: int, keys: str = "") -> Path:
    """Return a configuration that has nothing but the broker."""
    file = Path(tempfile.mkdtemp(dir=FOLDER.name)) / "broker.toml"
    file.write_text(f'[messenger]\ndriver = "mqtt"\nhost = "{HOST}"\nport = {port}\n{keys}')
    return file


def fleet_at(port: int, *words: object) -> Typed:
    return typed("fleet", broker_file(port), "--wait", LISTEN, *words)


def settled(port: int, condition: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """Return the first record of the fleet of which something is so."""

    def look() -> dict[str, Any] | None:
        found = fleet_at(port, "--json")
        if found.returncode != 0:  # a busy machine takes long to connect
            return None
        record: dict[str, Any] = json.loads(found.stdout)
        return record if condition(record) else None

    record = eventually(look)
    assert record is not None
    return record


def measured(record: dict[str, Any]) -> bool:
    """Return whether every target of every device that was heard has a distance."""
    targets = [target for device in record["devices"] for target in device["targets"]]
    return bool(targets) and all(target["distance_m"] is not None for target in targets)


def test_devices_and_alarms_are_one_object_and_one_screen(broker: MosquittoBroker, device: Client) -> None:
    say(device, "garage/info", {"v": 1, "version": "0.1.0", "configuration_sha256": "9f86", "boot_id": "6f1c"})
    rule = {"active": True, "severity": "warning", "acknowledged": False, "since": NOON, "reason": "0.48 m is near"}
    say(device, "garage/rule/near/state", rule)
    say(device, "hall/press/availability", "offline")
    with living(device, "garage"):
        record = settled(broker.port, lambda each: len(each["devices"]) == 2 and each["devices"][0]["targets"])
        screen = fleet_at(broker.port).stdout
    garage, press = record["devices"]
    assert (garage["device"], garage["status"], garage["version"], garage["standing"]) == (
        "garage",
        "online",
        "0.1.0",
        1,
    )
    assert garage["targets"][0]["distance_m"] == 1.482
    assert garage["age_s"] < STALE_S
    assert (press["device"], press["status"], press["age_s"]) == ("hall/press", "offline", None)
    assert [alarm["reason"] for alarm in record["alarms"]] == ["0.48 m is near"]
    assert record["troubles"] == ["hall/press: offline"]
    for words in ("1 online", "1 offline", "hall/press", "ball 1.48 m ± 0.02", "garage/near", "UNACKNOWLEDGED"):
        assert words in screen


def test_a_script_learns_from_the_exit_code_whether_all_is_well(broker: MosquittoBroker, device: Client) -> None:
    def checked() -> tuple[int, str]:
        found = fleet_at(broker.port, "--check")
        return found.returncode, found.stdout

    assert checked() == (1, "no device was heard below stadimeter/\n")
    with living(device, "garage", "attic"):
        say(device, "garage/rule/near/state", {"active": True, "severity": "warning", "reason": "near"})
        well = (0, "2 devices are online, and no serious alarm stands\n")
        eventually(lambda: checked() == well)
        say(device, "attic/rule/near/state", {"active": True, "severity": "safety", "reason": "0.48 m"})
        say(device, "cellar/availability", "offline")
        eventually(lambda: checked() == (1, "cellar: offline\nattic/near: safety: 0.48 m\n"))


@pytest.mark.parametrize("what", [("--check",), ("--acknowledge", "garage/near")])
def test_no_answer_of_the_broker_is_exit_code_2(what: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "CONNECT_S", 0.0)
    port = free_port()
    found = fleet_at(port, *what)
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr == f"error: {HOST}:{port} refused the connection (is a broker running there?)\n"


@pytest.mark.parametrize(
    ("keys", "words", "error"),
    [
        ('password_file = "none"', (), "messenger: password_file is given without a username"),
        ("", ("--wait", "long"), "--wait: "),
        ("", ("--acknowledge", "near"), "--acknowledge: 'stadimeter/near' is no NODE/RULE"),
    ],
)
def test_what_cannot_be_meant_is_said_in_a_line(keys: str, words: tuple[str, ...], error: str) -> None:
    found = typed("fleet", broker_file(free_port(), keys), *words)
    assert found.returncode == 2
    assert error in found.stderr
    assert (found.stderr.count("error: "), found.stdout) == (1, "")


def test_the_broker_of_a_configuration_is_used_and_what_is_below_its_first_level_or_another(
    broker: MosquittoBroker, device: Client, tmp_path: Path
) -> None:
    config = tmp_path / "here.toml"
    config.write_text(f'[messenger]\ndriver = "mqtt"\nport = {broker.port}\nbase_topic = "plant/hall/here"\n')
    device.publish("plant/hall/there/availability", "offline", 1, True).wait_for_publish(WAIT_S)
    say(device, "garage/availability", "offline")

    def says(words: str, *options: object) -> bool:
        return words in typed("fleet", config, *options, "--check", "--wait", LISTEN).stdout

    eventually(lambda: says("hall/there: offline"))
    eventually(lambda: says("garage: offline", "--below", "stadimeter"))


def test_a_device_that_does_not_answer_is_an_error(broker: MosquittoBroker) -> None:
    unanswered = fleet_at(broker.port, "--acknowledge", "garage/near")
    assert unanswered.returncode == 2
    assert unanswered.stderr.startswith("error: stadimeter/garage did not answer within 0.3 s; is it online")


@contextmanager
def running(folder: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    """Run the real program, connected to a broker, with an alarm that stands."""
    messenger = f'[messenger]\ndriver = "mqtt"\nport = {port}\nnode = "garage"\n'
    (folder / "garage.toml").write_text(SIMULATED_BALL + STANDING_ALARM + messenger)
    command = [sys.executable, "-m", "stadimeter", "run", str(folder / "garage.toml"), "--seconds", "600"]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield run
    finally:
        run.kill()
        run.wait(WAIT_S)


@pytest.mark.long
def test_a_real_run_is_seen_with_its_alarm_which_is_acknowledged_and_its_death(
    broker: MosquittoBroker, tmp_path: Path
) -> None:
    with running(tmp_path, broker.port) as run:
        # An alarm is published before the state of its target, which has no distance while it is searched.
        record = settled(broker.port, lambda each: each["alarms"] and measured(each))
        (device,), (alarm,) = record["devices"], record["alarms"]
        assert (device["device"], alarm["rule"], alarm["severity"]) == ("garage", "near", "alarm")
        assert len(device["configuration_sha256"]) == 64
        assert device["targets"][0]["distance_m"] == pytest.approx(2.0, abs=0.2)
        assert device["unreadable"] == 0
        assert not alarm["is_acknowledged"]
        done = typed("fleet", broker_file(broker.port), "--wait", "100 s", "--acknowledge", "garage/near")
        assert done.returncode == 0, done.stderr
        refused = typed("fleet", broker_file(broker.port), "--wait", "100 s", "--acknowledge", "garage/far")
        assert (refused.returncode, "far" in refused.stderr) == (1, True)
        settled(broker.port, lambda each: each["alarms"] and each["alarms"][0]["is_acknowledged"])
        run.send_signal(signal.SIGKILL)
        dead = settled(broker.port, lambda each: [device["status"] for device in each["devices"]] == ["offline"])
        assert dead["troubles"][0] == "garage: offline"


@pytest.mark.long
def test_the_screen_says_when_the_broker_is_gone_and_when_it_is_back(
    broker: MosquittoBroker, closing: ExitStack
) -> None:
    terminal = Terminal("fleet", str(broker_file(broker.port)), columns=120)
    closing.callback(terminal.close)
    with client_at(broker.port) as client, living(client, "garage"):
        try:
            terminal.wait_for("1 online")
            terminal.wait_for("ball 1.48 m ± 0.02")
            broker.stop()
            terminal.wait_for("NOT CONNECTED")
        finally:
            client.disconnect()
    broker.start()
    with client_at(broker.port) as client, living(client, "garage"):
        terminal.wait_for("1 online")
    assert terminal.ended(signal.SIGINT) == 0


def drawn(fleet: Fleet, now_s: float, *, trouble: str = "", width: int = 120, height: int = 20) -> tuple[str, str]:
    """Return a screen as text, and with its colours."""
    plain, coloured = io.StringIO(), io.StringIO()
    screen = FleetScreen(fleet, "broker:1883", trouble, now_s)
    Console(file=plain, width=width, height=height).print(screen)
    Console(file=coloured, width=width, height=height, force_terminal=True, color_system="standard").print(screen)
    return plain.getvalue(), coloured.getvalue()


def fleet_of(count: int) -> Fleet:
    fleet = Fleet("stadimeter")
    for number in range(count):
        tell(fleet, f"node-{number:03}/availability", b"online")
        tell(fleet, f"node-{number:03}/target/ball/state", {"seq": 1, "status": "tracking", "distance_m": 1.482})
    return fleet


def tell(fleet: Fleet, topic: str, payload: object, now_s: float = 0.0) -> None:
    data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    fleet.take(Received(topic=f"stadimeter/{topic}", payload=data), now_s)


GREY = "\x1b[90m"


def test_what_is_dead_is_grey_and_its_figures_say_how_old_they_are() -> None:
    fleet = fleet_of(1)
    tell(fleet, "node-000/rule/near/state", {"active": True, "severity": "alarm", "since": NOON, "reason": "0.48 m"})
    alive, alive_coloured = drawn(fleet, STALE_S)
    assert "online" in alive
    assert "old)" not in alive
    assert GREY not in alive_coloured
    for now_s, trouble in ((STALE_S + 0.1, ""), (1.0, "the connection was lost")):
        dead, coloured = drawn(fleet, now_s, trouble=trouble)
        device, alarm = (next(line for line in coloured.splitlines() if words in line) for words in ("1.48", "0.48 m"))
        assert "s old)" in device
        assert "silent" in dead if not trouble else "NOT CONNECTED: the connection was lost" in dead
        assert GREY in device
        assert GREY in alarm


@pytest.mark.parametrize("height", [5, 8, 20, 60])
def test_a_screen_has_no_more_lines_than_there_are_and_says_what_it_leaves_out(height: int) -> None:
    fleet = fleet_of(40)
    for number in range(30):
        rule = {"active": True, "severity": "warning", "acknowledged": number != 7, "reason": "x" * 300}
        tell(fleet, f"node-{number:03}/rule/near/state", rule)
    tell(fleet, "node-039/availability", b"offline")
    text, _ = drawn(fleet, 1.0, height=height, width=80)
    lines = text.splitlines()
    assert len(lines) <= height
    assert all(len(line) <= 80 for line in lines)
    if height == 20:
        assert "not shown" in text
        assert lines[2].split()[0] == "node-039"  # the worst first
        assert "node-007/near" in lines[lines.index(next(each for each in lines if "standing alarms" in each)) + 1]
