"""How the page is served: its address, its certificate, its connections, and its end."""

import asyncio
import contextlib
import gzip
import http.client
import json
import os
import signal
import socket
import subprocess
import sys

import pytest

from stadimeter.config.extras import install_line
from stadimeter.errors import PageError
from stadimeter.testing.rig import eventually
from stadimeter.web import serving
from stadimeter.web.links import RunLink, RunProcess
from stadimeter.web.passwords import PasswordFile
from stadimeter.web.serving import EVERYWHERE, check_certificate, listen
from support.browser import ROOM, served
from support.command_line import typed
from support.page import OPERATE, quicken, served_page
from support.processes import children, is_running
from support.programs import require


def test_without_a_password_others_cannot_reach_it(tmp_path):
    with listen(None, 0, tmp_path / "none") as listener:
        assert listener.getsockname()[0] == "127.0.0.1"
    with pytest.raises(PageError, match="set a password first"):
        listen("192.0.2.1", 0, tmp_path / "none")


def test_with_a_password_it_listens_everywhere(tmp_path, monkeypatch):
    quicken(monkeypatch)
    PasswordFile(tmp_path / "words").set("operate", OPERATE)
    with listen(None, 0, tmp_path / "words") as listener:
        assert listener.getsockname()[0] in EVERYWHERE
        socket.create_connection(("127.0.0.1", listener.getsockname()[1])).close()


def invoked(*words):
    """Start the page as a process of its own: the command becomes the server."""
    command = [sys.executable, "-m", "stadimeter", "web", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_a_port_in_use_is_a_sentence(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = invoked(tmp_path / "room.toml", "--port", port)
    assert done.returncode == 2
    assert done.stderr == f"error: port {port} is in use by another program; give another one with `--port`\n"


@pytest.mark.parametrize(("address", "words"), [("192.0.2.1", "cannot listen there"), ("999.1.1.1", "not known")])
def test_an_address_that_is_not_ours_is_a_sentence(tmp_path, monkeypatch, address, words):
    quicken(monkeypatch)
    PasswordFile(tmp_path / "room.passwords").set("operate", OPERATE)
    done = invoked(tmp_path / "room.toml", "--address", address, "--port", 0)
    assert (done.returncode, words in done.stderr) == (2, True)


@pytest.mark.parametrize("folder", [".", "/", "tests"])
def test_a_folder_is_no_configuration(folder):
    done = typed("web", folder)
    assert (done.returncode, f"{folder} is a folder" in done.stderr) == (2, True)


def test_without_the_extra_the_command_names_what_installs_it(tmp_path):
    code = f"""
import sys
sys.modules["starlette"] = None
import importlib.util
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "starlette" else find(name, *more)
from stadimeter.cli.main import app
app(["web", {str(tmp_path / "room.toml")!r}])"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    words = f"error: the page needs the extra `web`: {install_line('web')}\n"
    assert (done.returncode, done.stderr) == (2, words)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """Two certificates, each with its key."""
    require("openssl")
    folder = tmp_path_factory.mktemp("certificates")
    for name in ("one", "two"):
        command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
        files = ["-keyout", folder / f"{name}.key", "-out", folder / f"{name}.pem"]
        subprocess.run([*command, *files, "-subj", "/CN=localhost"], check=True, capture_output=True)
    return folder


@pytest.mark.parametrize(
    ("certificate", "key", "words"),
    [
        ("one.pem", "two.key", "no certificate with its key"),
        ("one.pem", "none.key", "none.key cannot be read"),
        ("one.key", "one.key", "no certificate with its key"),
        ("one.pem", "locked.key", "without a passphrase"),
    ],
)
def test_a_certificate_that_does_not_fit_is_a_sentence(pairs, certificate, key, words):
    command = ["openssl", "ec", "-aes256", "-passout", "pass:secret", "-in", pairs / "one.key"]
    subprocess.run([*command, "-out", pairs / "locked.key"], check=True, capture_output=True)
    with pytest.raises(PageError, match=words):
        check_certificate(pairs / certificate, pairs / key)


@pytest.mark.long
def test_it_ends_at_once_also_with_streams_that_are_open(tmp_path):
    """A grace of uvicorn's would be cut short only by its time-out; here the streams end by themselves."""
    with served(tmp_path, None, runs=False) as here:
        connection = http.client.HTTPConnection(here.url.removeprefix("http://"), timeout=120)
        connection.request("GET", "/api/v1/live")
        response = connection.getresponse()
        assert b"gone" in response.read(40)
        here.page.send_signal(signal.SIGINT)
        assert here.page.wait(120) == 0
        assert response.read().count(b"gone") <= 1  # and the stream came to its proper end
        connection.close()


@pytest.mark.long
def test_the_workbench_ends_with_a_page_that_is_killed_and_frees_its_camera(tmp_path):
    with served(tmp_path, runs=False) as here:
        assert asked(here, "POST", "/api/v1/setup/begin", {"anew": True})[0] == 200
        assert asked(here, "POST", "/api/v1/setup/camera", {"camera": "simulated"})[0] == 200
        (workbench,) = children(here.page.pid)
        here.page.kill()
        here.page.wait()
        assert eventually(lambda: not is_running(workbench))


def asked(here, method, path, body=None):
    """Ask a page that is served by another process, as a page of its own does."""
    connection = http.client.HTTPConnection(here.url.removeprefix("http://"), timeout=60)
    try:
        headers = {"Origin": here.url, "Content-Type": "application/json"}
        connection.request(method, path, body and json.dumps(body), headers)
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())
    finally:
        connection.close()


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "ended"),
    [(signal.SIGTERM, True), (signal.SIGHUP, True), (signal.SIGKILL, False)],
    ids=["it was asked to", "its terminal was closed", "it was killed"],
)
def test_the_run_ends_with_the_page_that_started_it_however_that_ends(tmp_path, number, ended):
    with served(tmp_path, runs=False) as here:
        assert asked(here, "POST", "/api/v1/run/start")[0] == 200
        told = told_of_the_run(here)
        assert told["is_running"]
        assert asked(here, "POST", "/api/v1/run/start")[1]["error"]["code"] == "is-running"
        here.page.send_signal(number)
        assert (here.page.wait(120) == 0) == ended
        assert eventually(lambda: not is_running(told["pid"]))


@pytest.mark.long
def test_no_second_run_is_started_beside_one_that_answers_nothing_for_a_while(tmp_path):
    """As one that begins anew, which takes a small Pi seconds."""
    with served(tmp_path) as here:
        run = asked(here, "GET", "/api/v1/session")[1]["run"]["pid"]
        os.kill(run, signal.SIGSTOP)
        status, told = asked(here, "POST", "/api/v1/run/start")
        may_start = told_of_the_run(here)["may_start"]
        os.kill(run, signal.SIGCONT)
        assert not may_start
        assert (status, f"process {run}" in told["error"]["message"]) == (409, True)
        assert children(here.page.pid) == []
        here.run.kill()
        here.run.wait()
        assert asked(here, "POST", "/api/v1/run/start")[0] == 200  # now there is none


@pytest.mark.long
def test_a_run_that_does_not_start_says_why(tmp_path):
    with served(tmp_path, "[camera\n", runs=False) as here:
        status, told = asked(here, "POST", "/api/v1/run/start")
        assert (status, "stadimeter.toml:1" in told["error"]["message"]) == (409, True)


PINS = """
[actuators.lamp]
driver = "led"
pin = 23

[rules.light]
actuator = "lamp"
when = { below = "1 m" }
"""


@pytest.mark.long
def test_a_run_that_ends_after_its_start_is_told_with_its_last_words(tmp_path, monkeypatch):
    monkeypatch.setenv("GPIOZERO_PIN_FACTORY", "none-of-these")
    with served(tmp_path, ROOM + PINS, runs=False) as here:
        asked(here, "POST", "/api/v1/run/start")
        eventually(lambda: told_of_the_run(here)["words"].startswith("the run has ended: lamp: "))


def told_of_the_run(here):
    return asked(here, "GET", "/api/v1/session")[1]["run"]


def test_a_service_starts_the_run_itself(tmp_path):
    link = RunLink(tmp_path / "room.toml", tmp_path / "none.sock")
    with pytest.raises(PageError, match="systemctl start stadimeter"):
        asyncio.run(RunProcess(link, {"INVOCATION_ID": "7"}).start())


@pytest.mark.parametrize(
    ("environment", "may_start"),
    [
        ({}, True),
        ({"INVOCATION_ID": "7", "SYSTEMD_EXEC_PID": str(os.getpid())}, False),
        ({"INVOCATION_ID": "7", "SYSTEMD_EXEC_PID": "1"}, True),
    ],
    ids=["a shell", "a service", "a terminal that is a service"],
)
def test_only_what_systemd_itself_has_started_leaves_the_run_to_it(tmp_path, environment, may_start):
    link = RunLink(tmp_path / "room.toml", tmp_path / "none.sock")
    assert RunProcess(link, environment).may_start == may_start


def all_received(connection):
    """Return what comes over a connection until its end."""
    received = b""
    with contextlib.suppress(ConnectionResetError):
        while more := connection.recv(65536):
            received += more
    return received


LOGIN = b"GET /login HTTP/1.1\r\nHost: localhost\r\n\r\n"


def test_files_of_the_page_are_compressed_where_the_browser_takes_that(tmp_path):
    with served_page(tmp_path) as here:
        for path in ("/", "/static/style.css", "/static/app.js", "/static/vendor/uplot/uPlot.js"):
            plain, small = here.get(path), here.get(path, **{"Accept-Encoding": "gzip"})
            assert plain.headers["Content-Encoding"] is None
            assert small.headers["Content-Encoding"] == "gzip"
            assert gzip.decompress(small.body) == plain.body
            assert len(small.body) < 0.6 * len(plain.body)
            again = here.get(path, **{"Accept-Encoding": "gzip", "If-None-Match": small.headers["ETag"]})
            assert (again.status, again.body) == (304, b"")


def test_a_connection_that_asks_nothing_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(serving, "IDLE_MAX_S", 0.2)
    with served_page(tmp_path) as site:
        for said in (b"", b"GET / HTTP/1.1\r\nHost: local", LOGIN):
            with socket.create_connection(("127.0.0.1", site.port), timeout=120) as connection:
                connection.sendall(said)
                assert all_received(connection).startswith(b"HTTP/1.1 200") == (said == LOGIN)


def test_a_head_of_a_request_has_a_bound_while_it_comes(tmp_path):
    with served_page(tmp_path) as site, socket.create_connection(("127.0.0.1", site.port), timeout=120) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 100_000)
        assert connection.recv(1000).startswith(b"HTTP/1.1 4")


def test_no_more_are_connected_than_there_is_room_for(tmp_path, monkeypatch):
    monkeypatch.setattr(serving, "CONNECTIONS_MAX", 3)
    with served_page(tmp_path) as site:
        held = [socket.create_connection(("127.0.0.1", site.port), timeout=120) for _ in range(3)]
        for each in held:
            each.sendall(LOGIN)
            assert each.recv(1000).startswith(b"HTTP/1.1 200")
        with socket.create_connection(("127.0.0.1", site.port), timeout=120) as fourth:
            assert ended(fourth)
        held.pop().close()
        assert eventually(lambda: is_let_in(site.port))
        for each in held:
            each.close()


def ended(connection):
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


def is_let_in(port):
    with socket.create_connection(("127.0.0.1", port), timeout=120) as trial:
        trial.sendall(LOGIN)
        return not ended(trial)
