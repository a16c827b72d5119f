"""A run that begins anew in its process: as a program, seen by systemd and by its clients."""

import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress

import pytest

from stadimeter.app.control.client import ask
from stadimeter.app.control.messages import NoArgs
from stadimeter.app.control.reloading import Restarter, build_parts
from stadimeter.app.loop import Services
from stadimeter.errors import ControlError
from stadimeter.testing.rig import eventually
from support.simulated_run import SIMULATED_BALL

ROOM = (
    SIMULATED_BALL
    + """
[rules.far]
actuator = "motor"
ramp = { from = "1 m", to = "1.5 m" }

[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""
)


class Program:
    """``stadimeter run`` as a service of systemd."""

    def __init__(self, folder, text):
        self.folder, self.socket = folder, folder / "run.sock"
        folder.chmod(0o700)
        self.configuration = folder / "room.toml"
        self.configuration.write_text(text)
        self.systemd = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.systemd.bind(str(folder / "notify"))
        self.systemd.setblocking(False)
        self._heard = []
        environment = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": "3000000"}
        command = [sys.executable, "-m", "stadimeter", "run", str(self.configuration), "--socket", str(self.socket)]
        self.log = (folder / "said").open("w+")
        self.process = subprocess.Popen(command, env=environment, stdout=self.log, stderr=self.log)
        assert eventually(self.hello), self.said()

    @property
    def heard(self):
        """Every line that systemd was told so far."""
        with suppress(BlockingIOError):
            while True:
                self._heard += self.systemd.recv(65536).decode().split("\n")
        return self._heard

    def hello(self):
        try:
            return ask(self.socket, "hello")
        except ControlError:
            return None

    def said(self):
        return (self.folder / "said").read_text()

    def end(self):
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(120)


@pytest.fixture
def program(tmp_path):
    begun = []

    def begin(text=ROOM):
        begun.append(Program(tmp_path, text))
        return begun[0]

    yield begin
    for each in begun:
        each.process.kill()
        each.process.wait()
        each.log.close()
        each.systemd.close()


@pytest.mark.long
def test_it_goes_on_as_the_same_process_with_what_no_reload_takes_over(program):
    run = program()
    before = run.hello()
    run.configuration.write_text(ROOM.replace('rate = "30 Hz"', 'rate = "20 Hz"'))
    with pytest.raises(ControlError, match=r"restart to change \[camera\]"):
        ask(run.socket, "reload")
    assert ask(run.socket, "restart", wait_s=20) == {"words": "restarting"}
    assert eventually(lambda: (run.hello() or before)["digest"] != before["digest"]), run.said()
    assert run.hello()["pid"] == before["pid"] == run.process.pid
    assert eventually(lambda: run.heard.count("READY=1") == 2)
    first, second = (i for i, line in enumerate(run.heard) if line == "READY=1")
    between = run.heard[first:second]
    assert "RELOADING=1" in between
    assert "WATCHDOG_USEC=30000000" in between
    assert "STOPPING=1" not in run.heard  # systemd would count that as the end of the service
    assert "WATCHDOG_USEC=3000000" in run.heard[second:]
    assert run.end() == 0
    assert run.heard[-1] == "STOPPING=1"


@pytest.mark.long
def test_nothing_ends_if_the_file_is_wrong_and_the_answer_names_each_problem(program):
    run = program()
    assert eventually(lambda: ask(run.socket, "status")["safety"] == "active")
    run.configuration.write_text(ROOM.replace('actuator = "motor"', 'actuator = "rotor"'))
    with pytest.raises(ControlError, match="rotor"):
        ask(run.socket, "restart", wait_s=20)
    assert ask(run.socket, "status")["safety"] == "active"
    run.configuration.write_text(ROOM)
    assert ask(run.socket, "restart", wait_s=20) == {"words": "restarting"}


def test_a_run_whose_end_is_asked_for_while_a_restart_is_checked_begins_anew_no_more():
    goes_on, answers = threading.Event(), []
    services = Services(restarter=Restarter(goes_on.wait))
    services.restarter.act(NoArgs(), answers.append)
    services.cancel_restart()
    goes_on.set()
    assert eventually(lambda: answers)
    for thread in threading.enumerate():
        if thread.name == "restart":
            thread.join()
    assert not services.is_restart_due


def test_the_problems_of_a_file_go_with_the_answer(tmp_path):
    path = tmp_path / "room.toml"
    path.write_text(ROOM.replace('actuator = "motor"', 'actuator = "rotor"'))
    answers = []
    Restarter(lambda: build_parts(path)).act(NoArgs(), answers.append)
    assert eventually(lambda: answers)
    assert [problem.line for problem in answers[0].problems] == [ROOM.split("rules.far")[0].count("\n") + 2]
    assert b'"problems":[{"message":' in answers[0].line(None)
