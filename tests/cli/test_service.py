"""The whole program as a service: a real process, the socket that systemd has, and what systemd does in the silence."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from stadimeter.testing.rig import eventually
from support.cameras import StreamServer
from support.simulated_run import LENS, SIMULATED_BALL

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"

HANGS_S = 120.0
"""Whatever has not happened by then does not happen."""

WATCHDOG_S = 1.5

PINS = """
[actuators.buzzer]
driver = "vibration-motor"
pin = 18
[actuators.fan]
driver = "relay"
pin = 5
active_high = false
[rules.near]
actuator = "buzzer"
when = { below = "3 m" }
"""

SEEN = SIMULATED_BALL + PINS + '[world]\npath = [{ at = "0 s", x = "2 m", y = "0 m" }]\n'

WATCHED = """
[camera]
driver = "opencv"
device = "ADDRESS"
latency = "20 ms"
width_px = 64
height_px = 48
""" + LENS.replace("640", "64").replace("480", "48").replace("319.5", "31.5").replace("239.5", "23.5") + """
[targets.ball]
detector = "ball"
diameter = "6 cm"
hsv = "29,86,6:64,255,255"
""" + PINS  # fmt: skip

IMPATIENT = """
from stadimeter.app import service
service.PATIENCE_S = service.PATIENCE_IF_HUNG_S = 0.5
from stadimeter.cli.main import main
main()
"""


class System:
    """Does for a process what systemd does for a service of Type=notify with a watchdog."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = folder / "box.toml"
        self.runtime, self.state = folder / "run", folder / "state"
        for each in (self.runtime, self.state):
            each.mkdir()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(folder / "notify"))
        self.process: subprocess.Popen[str] | None = None
        self.status = ""

    def start(self, *program: str) -> None:
        environ = {
            **os.environ,
            "NOTIFY_SOCKET": str(self.folder / "notify"),
            "WATCHDOG_USEC": f"{WATCHDOG_S * 1e6:.0f}",
            "RUNTIME_DIRECTORY": str(self.runtime),
            "STATE_DIRECTORY": str(self.state),
            "GPIOZERO_PIN_FACTORY": "mock",
        }
        self.process = subprocess.Popen(
            [sys.executable, *(program or ("-m", "stadimeter")), "run", str(self.config)],
            env=environ,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def waits_for(self, wanted: Callable[[str], bool], seconds: float = HANGS_S) -> bool:
        """Take what the process sends until a line is wanted; return False if it is silent for so long, or for ever."""
        self._socket.settimeout(seconds)
        ends_s = time.monotonic() + HANGS_S
        while time.monotonic() < ends_s:
            try:
                lines = self._socket.recv(65536).decode().split("\n")
            except TimeoutError:
                return False
            self.status = next((line for line in lines if line.startswith("STATUS=")), self.status)
            if any(map(wanted, lines)):
                return True
        return False

    def kill(self, within_s: float = HANGS_S) -> str:
        """Abort the process, kill it if that does not end it in time, and return what it had said."""
        assert self.process is not None
        self.process.send_signal(signal.SIGABRT)
        try:
            said = self.process.communicate(timeout=within_s)[0]
        except subprocess.TimeoutExpired:
            self.process.kill()
            said = self.process.communicate()[0]
        return said

    def ended(self) -> str:
        assert self.process is not None
        return self.process.communicate(timeout=HANGS_S)[0]

    def stop_post(self) -> list[str]:
        """Run safe-outputs with a pretended pinctrl; return which pins it drove."""
        tools = self.folder / "bin"
        tools.mkdir()
        (tools / "pinctrl").write_text(f'#!/bin/sh\necho "$*" >>"{self.folder}/pins"\n')
        (tools / "pinctrl").chmod(0o755)
        path = f"{tools}:{os.environ['PATH']}"
        command = ["sh", str(DEPLOY / "safe-outputs"), str(self.runtime / "safe-outputs.conf")]
        subprocess.run(command, env={**os.environ, "PATH": path}, check=True, timeout=HANGS_S)
        return (self.folder / "pins").read_text().splitlines()

    def log(self) -> str:
        log = self.state / "box.log"
        return log.read_text() if log.exists() else ""

    def close(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
        self._socket.close()


@pytest.fixture
def system(tmp_path: Path) -> Iterator[System]:
    system = System(tmp_path)
    yield system
    system.close()


def is_feed(line: str) -> bool:
    return line == "WATCHDOG=1"


def is_ready(line: str) -> bool:
    return line == "READY=1"


@pytest.mark.long
def test_a_process_that_hangs_as_a_whole_is_killed_and_its_pins_are_switched_off(system: System) -> None:
    system.config.write_text(SEEN)
    system.start()
    assert system.waits_for(is_ready)
    assert system.waits_for(lambda line: line.startswith("STATUS=ball 2.00 m, "))
    assert system.process is not None
    system.process.send_signal(signal.SIGSTOP)
    assert not system.waits_for(lambda _line: False, WATCHDOG_S)
    system.kill(1.0)
    assert system.process.returncode == -signal.SIGKILL  # it could not take the first signal
    assert system.stop_post() == ["set 18 op dl", "set 5 op dh"]


@pytest.mark.long
def test_a_loop_that_hangs_starves_the_watchdog_and_says_where_it_hangs(system: System) -> None:
    system.config.write_text(SEEN)
    hanging = """
import time
from stadimeter.app.cycle import Cycle
calls, real = [], Cycle.run
def run(*args):
    calls.append(args)
    if len(calls) > 60:
        time.sleep(1000)
    return real(*args)
Cycle.run = run
from stadimeter.cli.main import main
main()
"""
    system.start("-c", hanging)
    assert system.waits_for(is_ready)
    eventually(lambda: "raised" in system.log())
    assert not system.waits_for(lambda _line: False, WATCHDOG_S)
    said = system.kill()
    assert system.process is not None
    assert system.process.returncode == -signal.SIGABRT
    assert "in _run_cycles" in said


@pytest.mark.long
def test_asked_to_end_it_says_so_and_its_next_start_has_nothing_to_wait_for(system: System) -> None:
    system.config.write_text(SEEN)
    system.start()
    assert system.waits_for(is_ready)
    assert (system.runtime / "failed-starts").exists()
    assert system.process is not None
    system.process.terminate()
    assert system.waits_for(lambda line: line == "STOPPING=1")
    said = system.ended()
    assert system.process.returncode == 0
    assert not (system.runtime / "failed-starts").exists()
    first, *_, last = system.log().splitlines()
    assert " started: stadimeter " in first
    assert last.endswith(" ended: SIGTERM")
    assert said.count("STARTING") == 1, "a line a second would wear out the disk of a persistent journal"


@pytest.mark.long
def test_a_camera_that_is_not_there_is_waited_for_and_then_used_with_the_process_alive(system: System) -> None:
    server = StreamServer()
    port = int(server.address.split(":")[2].split("/")[0])
    server.stop()
    system.config.write_text(WATCHED.replace("ADDRESS", server.address))
    system.start()
    assert system.waits_for(is_ready)
    assert system.waits_for(lambda line: "opening the camera again" in line)
    assert all(system.waits_for(is_feed) for _ in range(5))
    server = StreamServer(port)
    try:
        assert system.waits_for(lambda line: line.startswith("STATUS=") and line.endswith(" fps"))
    finally:
        server.stop()
    assert system.waits_for(lambda line: "outputs are safe" in line)
    assert system.waits_for(is_feed)


@pytest.mark.long
def test_a_camera_that_stays_away_ends_the_process_in_order_and_the_next_is_more_patient(system: System) -> None:
    server = StreamServer()
    server.stop()
    system.config.write_text(WATCHED.replace("ADDRESS", server.address))
    for starts, next_s in ((1, "1 s"), (2, "2 s")):
        system.start("-c", IMPATIENT)
        assert system.waits_for(lambda line: line == "STOPPING=1")
        said = system.ended()
        assert system.process is not None
        assert system.process.returncode == 2
        assert said.splitlines()[-1].startswith("error: no new picture for ")
        assert said.splitlines()[-1].endswith(f"after {next_s}")
        assert (system.runtime / "failed-starts").read_text().split()[0] == str(starts)


@pytest.mark.long
def test_a_reload_is_announced(system: System) -> None:
    system.config.write_text(SEEN)
    system.start()
    assert system.waits_for(is_ready)
    system.config.write_text(SEEN.replace("3 m", "4 m"))
    assert system.process is not None
    system.process.send_signal(signal.SIGHUP)
    assert system.waits_for(lambda line: line == "RELOADING=1")
    assert system.waits_for(is_ready)
