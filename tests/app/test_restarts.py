"""A run that begins anew in its process: as a program, with a page beside it, seen by systemd and by its clients."""

import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import pytest

from stadimeter.app.control.client import ask
from stadimeter.app.control.messages import NoArgs
from stadimeter.app.control.restarting import Restarter, built
from stadimeter.app.loop import Services
from stadimeter.app.page_process import PageProcess
from stadimeter.errors import ControlError
from stadimeter.testing.eventually import eventually
from support.processes import children, is_running
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


def free_port():
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return trial.getsockname()[1]


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


def test_nothing_ends_if_the_file_is_wrong_and_the_answer_names_each_problem(program):
    run = program()
    assert eventually(lambda: ask(run.socket, "status")["safety"] == "active")
    run.configuration.write_text(ROOM.replace('actuator = "motor"', 'actuator = "rotor"'))
    with pytest.raises(ControlError, match="rotor"):
        ask(run.socket, "restart", wait_s=20)
    assert ask(run.socket, "status")["safety"] == "active"
    run.configuration.write_text(ROOM)
    assert ask(run.socket, "restart", wait_s=20) == {"words": "restarting"}


@pytest.mark.skipif(not (find_spec("uvicorn") and find_spec("starlette")), reason="the extra web is not installed")
def test_a_page_lives_through_a_restart_and_ends_with_the_run(program):
    port = free_port()
    run = program(f'{ROOM}\n[web]\nport = {port}\nhost = "127.0.0.1"\n')

    def is_served():
        with socket.socket() as browser:
            return browser.connect_ex(("127.0.0.1", port)) == 0

    assert eventually(lambda: f"The page: http://127.0.0.1:{port}/" in run.said())
    assert is_served()
    (page,) = children(run.process.pid)
    run.heard.clear()
    ask(run.socket, "restart", wait_s=20)
    assert eventually(lambda: "READY=1" in run.heard), run.said()
    assert children(run.process.pid) == [page]
    assert run.end() == 0
    assert eventually(lambda: not is_served())
    assert eventually(lambda: not is_running(page))


@pytest.mark.skipif(not (find_spec("uvicorn") and find_spec("starlette")), reason="the extra web is not installed")
def test_a_page_ends_with_a_run_that_is_killed_also_after_a_restart_and_frees_its_port(program):
    port = free_port()
    run = program(f'{ROOM}\n[web]\nport = {port}\nhost = "127.0.0.1"\n')
    assert eventually(lambda: "The page: " in run.said())
    (page,) = children(run.process.pid)
    run.heard.clear()
    ask(run.socket, "restart", wait_s=20)
    assert eventually(lambda: "READY=1" in run.heard), run.said()
    assert children(run.process.pid) == [page]
    run.process.kill()
    run.process.wait()
    assert eventually(lambda: not is_running(page))
    socket.create_server(("127.0.0.1", port)).close()


@pytest.mark.skipif(not (find_spec("uvicorn") and find_spec("starlette")), reason="the extra web is not installed")
def test_a_page_ends_with_a_restart_after_which_the_configuration_has_none(program):
    run = program(f'{ROOM}\n[web]\nport = {free_port()}\nhost = "127.0.0.1"\n')
    assert eventually(lambda: "The page: " in run.said())
    (page,) = children(run.process.pid)
    run.configuration.write_text(ROOM)
    run.heard.clear()
    ask(run.socket, "restart", wait_s=20)
    assert eventually(lambda: "READY=1" in run.heard), run.said()
    assert eventually(lambda: not is_running(page))


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
    Restarter(lambda: built(path)).act(NoArgs(), answers.append)
    assert eventually(lambda: answers)
    assert [problem.line for problem in answers[0].problems] == [ROOM.split("rules.far")[0].count("\n") + 2]
    assert b'"problems":[{"message":' in answers[0].line(None)


class TestPageProcess:
    """A page that is any program: what is said of it, and how it ends."""

    def page(self, code, told):
        return PageProcess([sys.executable, "-c", code], told.append)

    def test_where_it_is_is_told_and_what_else_it_says_is_not(self):
        told = []
        page = self.page("import time; print('The page: http://x/'); print('more'); time.sleep(60)", told)
        page.start()
        assert eventually(lambda: told == ["The page: http://x/"])
        page.end()
        assert told == ["The page: http://x/"]
        assert not page._pid

    def test_one_that_dies_is_started_again_and_the_same_trouble_is_told_once(self, monkeypatch):
        monkeypatch.setattr("stadimeter.app.page_process.FIRST_WAIT_S", 0.01)
        told, begun = [], []
        from stadimeter.app import page_process

        spawn = page_process._begun
        monkeypatch.setattr(page_process, "_begun", lambda command: begun.append(1) or spawn(command))
        page = self.page("import sys; sys.exit('error: the port is taken')", told)
        page.start()
        assert eventually(lambda: len(begun) >= 3)
        page.end()
        assert told == ["warning: the page has ended and is started again: the port is taken"]

    def test_one_that_cannot_be_started_is_tried_again(self, monkeypatch):
        monkeypatch.setattr("stadimeter.app.page_process.FIRST_WAIT_S", 0.01)
        told = []
        page = self.page("print('The page: http://x/'); input()", told)
        page._command[0], python = "/no/such/python", page._command[0]
        page.start()
        assert eventually(lambda: told)
        assert told[0].endswith("started again: it cannot be started: No such file or directory")
        page._command[0] = python
        assert eventually(lambda: "The page: http://x/" in told)
        page.end()

    def test_one_that_does_not_heed_the_end_is_killed(self):
        told = []
        code = "import signal, time; signal.signal(15, signal.SIG_IGN); print('The page: x'); time.sleep(60)"
        page = self.page(code, told)
        page.start()
        assert eventually(lambda: told)
        pid = page._pid
        page.end()
        assert not Path(f"/proc/{pid}").exists()

    def test_it_is_told_nothing_that_is_meant_for_the_run_and_knows_where_it_is(self, monkeypatch):
        monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
        told = []
        page = self.page("import os; print('The page:', os.environ.get('NOTIFY_SOCKET')); input()", told)
        page.start()
        assert eventually(lambda: told)
        page.end()
        assert told[0] == "The page: None"
