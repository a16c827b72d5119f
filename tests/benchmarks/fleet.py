"""Many simulated devices at a real broker, and the real ``fleet``: what arrives, and what it costs.

Each device is a paho client of its own, with the topics, payloads, last will and retained messages of the program. One
``fleet --json`` counts what arrives; another draws the live view on a pseudo-terminal.

    python tests/benchmarks/fleet.py --minutes 10
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import threading
import time
from collections import Counter
from contextlib import suppress
from fcntl import ioctl
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.broker import HOST, BrokerAccess, MosquittoBroker

ROOT = Path(__file__).parents[2]
STADIMETER = (sys.executable, "-m", "stadimeter")
START_S = 60.0
STATES_EVERY_S = 0.5
ALARM_EVERY_S = 60.0
ALARM_STANDS_S = 10.0
NOON = "2026-06-01T12:00:00.000+00:00"


class SimulatedDevice:
    """A device: says what it measures twice a second, and raises an alarm once a minute."""

    def __init__(self, port: int, number: int, counts: Counter[str]) -> None:
        self.base = f"stadimeter/site-{number // 50}/node-{number}"
        self._counts = counts
        self._sequence = self._events = 0
        self._is_raised = False
        self.client = Client(
            CallbackAPIVersion.VERSION2,
            client_id=f"stadimeter-node-{number}",
            protocol=MQTTProtocolVersion.MQTTv5,
            reconnect_on_failure=False,
        )
        self.client.will_set(f"{self.base}/availability", "offline", 1, retain=True)
        self.client.connect(HOST, port, keepalive=15)
        self.next_state_s = self.next_alarm_s = 0.0

    def begin(self, now_s: float, share: float) -> None:
        self.next_state_s = now_s + share * STATES_EVERY_S
        self.next_alarm_s = now_s + share * (ALARM_EVERY_S - ALARM_STANDS_S)
        self.publish("availability", "online", retain=True)
        info = {"v": 1, "version": "0.1.0", "configuration_sha256": "9f86d081" * 8, "boot_id": "6f1c2d0e" * 4}
        self.publish("info", json.dumps(info), retain=True)

    def act(self, now_s: float) -> None:
        """Publish what is due."""
        if now_s >= self.next_state_s:
            self.next_state_s += STATES_EVERY_S
            self._say_state()
        if now_s >= self.next_alarm_s:
            self._is_raised = not self._is_raised
            self.next_alarm_s += ALARM_STANDS_S if self._is_raised else ALARM_EVERY_S - ALARM_STANDS_S
            self._say_alarm()

    def _say_state(self) -> None:
        state = {
            "v": 1, "ts": NOON, "seq": self._sequence, "status": "tracking",
            "distance_m": 1.4 + self._sequence % 100 / 100, "sigma_m": 0.021, "closing_mps": 0.35,
            "bearing_rad": -0.113,
        }  # fmt: skip
        self._sequence += 1
        self._counts["states"] += 1
        expiry = Properties(PacketTypes.PUBLISH)
        expiry.MessageExpiryInterval = 10
        self.publish(
            "target/ball/state", json.dumps(state, separators=(",", ":")), qos=0, retain=True, properties=expiry
        )

    def _say_alarm(self) -> None:
        reason = "0.48 m is below 0.50 m" if self._is_raised else "0.62 m is not below 0.50 m"
        event = {
            "v": 1, "ts": NOON, "id": f"{self.base}-{self._events}",
            "event_type": "raised" if self._is_raised else "cleared", "rule": "too-close", "severity": "alarm",
            "reason": reason, "distance_m": 0.48, "sigma_m": 0.006, "notify": True, "first_out": False, "by": None,
        }  # fmt: skip
        state = {
            "v": 1, "ts": NOON, "active": self._is_raised, "status": "active" if self._is_raised else "idle",
            "severity": "alarm", "acknowledged": True, "latched": False, "first_out": False, "inhibits": [],
            "chattering": False, "data_lost": False, "since": NOON, "reason": reason,
        }  # fmt: skip
        self._events += 1
        self._counts["raised" if self._is_raised else "cleared"] += 1
        self.publish("event/alarm", json.dumps(event, separators=(",", ":")))
        self.publish("rule/too-close/state", json.dumps(state, separators=(",", ":")), retain=True)

    def publish(self, topic: str, payload: str, *, qos: int = 1, retain: bool = False, properties: Any = None) -> None:
        self._counts["messages"] += 1
        sent = self.client.publish(f"{self.base}/{topic}", payload, qos, retain, properties)
        assert sent.rc == 0, f"{self.base} lost its connection: {sent.rc}"


def simulate(port: int, numbers: range, seconds: float, tell: Any) -> None:
    """Be some devices for a while, in this thread; then wait, connected, for a line on standard input."""
    counts: Counter[str] = Counter()
    devices = [SimulatedDevice(port, number, counts) for number in numbers]
    poll = select.poll()
    by_socket = {device.client.socket().fileno(): device.client for device in devices}  # type: ignore[union-attr]
    for number in by_socket:
        poll.register(number, select.POLLIN)
    while not all(device.client.is_connected() for device in devices):
        _read(poll, by_socket, 0.1)
    began_s = time.monotonic()
    for number, device in enumerate(devices):
        device.begin(began_s, number / len(devices))
    latest_s = misc_s = 0.0
    while (now_s := time.monotonic()) < began_s + seconds:
        for device in devices:
            latest_s = max(latest_s, now_s - device.next_state_s)
            device.act(now_s)
        _read(poll, by_socket, 0.02)
        if now_s > misc_s:
            misc_s = now_s + 1.0
            _ping(by_socket)
    print(json.dumps({**counts, "latest_s": round(latest_s, 3)}), file=tell, flush=True)
    poll.register(sys.stdin.fileno(), select.POLLIN)
    while not _read(poll, by_socket, 0.5):
        _ping(by_socket)


def _ping(by_socket: dict[int, Client]) -> None:
    for client in by_socket.values():
        client.loop_misc()
        if client.want_write():
            client.loop_write()


def _read(poll: select.poll, by_socket: dict[int, Client], wait_s: float) -> bool:
    """Let clients read and ping; return whether standard input has something."""
    ready = [number for number, _ in poll.poll(wait_s * 1000)]
    for number in ready:
        if number in by_socket:
            by_socket[number].loop_read()
    return any(number not in by_socket for number in ready)


class Watched:
    """The processor time and the memory of a process."""

    def __init__(self, pid: int) -> None:
        self._folder = Path("/proc") / str(pid)
        self.began_cpu_s = self.cpu_s()

    def cpu_s(self) -> float:
        fields = (self._folder / "stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def peak_mb(self) -> float:
        return int((self._folder / "status").read_text().partition("VmHWM:")[2].split()[0]) * 1024 / 1e6

    def figures(self, seconds: float) -> dict[str, float]:
        share = (self.cpu_s() - self.began_cpu_s) / seconds
        return {"cpu_percent": round(100 * share, 1), "peak_mb": round(self.peak_mb(), 1)}


def measure(devices: int, processes: int, minutes: float, queued: int = 20_000) -> dict[str, Any]:
    """Return what was sent, what arrived, and what it cost.

    Args:
        queued: How many messages the broker keeps for a client that reads too slowly; mosquitto's default is 1000.
    """
    with TemporaryDirectory() as folder:
        broker = MosquittoBroker(Path(folder), BrokerAccess())
        broker._file.write_text(f"{broker._file.read_text()}max_queued_messages {queued}\n")
        broker.start()
        try:
            return _measure_at(broker, devices, processes, 60 * minutes)
        finally:
            broker.stop()


def _measure_at(broker: MosquittoBroker, devices: int, processes: int, seconds: float) -> dict[str, Any]:
    assert broker._process is not None
    at = ["--host", HOST, "--port", str(broker.port)]
    listening_s = seconds + 40
    counting = subprocess.Popen(
        [*STADIMETER, "fleet", *at, "--json", "--wait", f"{listening_s} s"], stdout=subprocess.PIPE, text=True
    )
    drawing, screen = _draw(at)
    try:
        time.sleep(15)  # both are subscribed before the first message
        each = devices // processes
        command = [sys.executable, __file__, "--simulate", str(broker.port), "--seconds", str(seconds)]
        loads = [
            subprocess.Popen(
                [*command, "--from", str(number * each), "--to", str((number + 1) * each)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            )
            for number in range(processes)
        ]  # fmt: skip
        watched = {
            "broker": Watched(broker._process.pid), "fleet --json": Watched(counting.pid), "fleet": Watched(drawing.pid)
        }  # fmt: skip
        load_before = os.getloadavg()
        began_s = time.monotonic()
        sent: Counter[str] = Counter()
        latest_s = 0.0
        for load in loads:
            told = json.loads(load.stdout.readline())  # type: ignore[union-attr]
            latest_s = max(latest_s, told.pop("latest_s"))
            sent.update(told)
        costs = {name: each.figures(time.monotonic() - began_s) for name, each in watched.items()}
        load_after = os.getloadavg()
        heard = json.loads(counting.communicate(timeout=listening_s + START_S)[0])
        for load in loads:
            load.communicate("\n", timeout=START_S)
    finally:
        for process in (counting, drawing):
            process.kill()
            process.wait()
    return {
        "devices": devices,
        "seconds": seconds,
        "sent": dict(sent),
        "latest_s": latest_s,
        "heard": {
            "messages": heard["messages"],
            "devices": len(heard["devices"]),
            "statuses": Counter(each["status"] for each in heard["devices"]),
            "states": sum(target["sequence"] + 1 for each in heard["devices"] for target in each["targets"]),
            "missed": sum(each["missed"] for each in heard["devices"]),
            "raised": heard["figures"]["alarms"],
            "passed_over": heard["passed_over"],
        },
        "costs": costs,
        "drawn_bytes": screen[0],
        "load_average": {"before": load_before, "after": load_after},
        "cores": os.cpu_count(),
    }


def _draw(at: list[str]) -> tuple[subprocess.Popen[bytes], list[int]]:
    """Start the live view on a terminal of 160 columns and 50 rows that takes all it gets; count the bytes."""
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 50, 160, 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color"}
    drawing = subprocess.Popen([*STADIMETER, "fleet", *at], stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    drawn = [0]

    def read() -> None:
        with suppress(OSError):
            while data := os.read(ours, 65_536):
                drawn[0] += len(data)

    threading.Thread(target=read, daemon=True).start()
    return drawing, drawn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=500)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--queued", type=int, default=20_000, help="max_queued_messages of the broker")
    parser.add_argument("--simulate", type=int, metavar="PORT", help=argparse.SUPPRESS)
    parser.add_argument("--from", type=int, dest="first", help=argparse.SUPPRESS)
    parser.add_argument("--to", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, help=argparse.SUPPRESS)
    wanted = parser.parse_args()
    if wanted.simulate:
        simulate(wanted.simulate, range(wanted.first, wanted.to), wanted.seconds, sys.stdout)
    else:
        print(json.dumps(measure(wanted.devices, wanted.processes, wanted.minutes, wanted.queued), indent=2))


if __name__ == "__main__":
    main()
