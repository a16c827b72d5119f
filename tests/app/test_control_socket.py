"""The control socket: requests in, answers out, and whatever comes in, the loop never waits."""

import contextlib
import json
import socket
import stat

import pytest

from stadimeter.app.control.messages import LINE_MAX_BYTES, Reply
from stadimeter.app.control.socket_server import WAITING_MAX, ControlSocket
from stadimeter.errors import ControlError
from stadimeter.testing.rig import eventually
from support.each_case import each_case

HELLO = {"configuration": "/etc/stadimeter/run.toml", "pid": 7}


@pytest.fixture
def control(tmp_path):
    control = ControlSocket(tmp_path / "run.sock", lambda: HELLO)
    control.open()
    yield control
    control.close()


class Client:
    """Somebody who asks, and can do so badly."""

    def __init__(self, control):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(str(control.path))
        self.socket.settimeout(120)
        self.file = self.socket.makefile("rb")

    def send(self, line):
        self.socket.sendall(line if isinstance(line, bytes) else json.dumps(line).encode() + b"\n")

    def answer(self):
        line = self.file.readline()
        return json.loads(line) if line else None

    def ask(self, line):
        self.send(line)
        return self.answer()

    def close(self):
        self.file.close()
        self.socket.close()


@pytest.fixture
def connect():
    """Return a function that connects to a socket; everybody hangs up at the end."""
    clients = []

    def connect(control):
        clients.append(Client(control))
        return clients[-1]

    yield connect
    for client in clients:
        client.close()


@pytest.fixture
def client(control, connect):
    return connect(control)


def is_heard(client):
    try:
        return client.ask({"op": "hello"}).get("data") == HELLO
    except OSError:  # it was hung up on
        return False


def taken(control, count=1):
    """Wait until so many requests are there, and take them."""
    asked = []

    def all_there():
        asked.extend(control.take())
        return len(asked) >= count

    assert eventually(all_there)
    return asked


def test_a_request_is_taken_by_the_loop_and_its_answer_comes_back_with_its_transaction(control, client):
    client.send({"transaction": "7", "op": "ack", "args": {"rule": "near", "by": "zoe"}})
    (asked,) = taken(control)
    assert asked.request.args.rule == "near"
    asked.answer(Reply({"words": "acknowledged"}))
    assert client.answer() == {"transaction": "7", "status": "ok", "data": {"words": "acknowledged"}}


def test_whoever_has_said_all_still_gets_the_answer(control, client):
    client.send({"transaction": 1, "op": "status"})
    client.socket.shutdown(socket.SHUT_WR)
    (asked,) = taken(control)
    asked.answer(Reply([]))
    assert client.answer() == {"transaction": 1, "status": "ok", "data": []}
    assert client.answer() is None


@each_case(
    ("line", "expected"),
    [
        (b"open the door\n", "this is not JSON"),
        (b"\xff\xfe\x00\n", "this is not JSON"),
        (b"[" * 5000 + b"\n", "this is not JSON"),
        (b"7\n", "a request is a JSON object"),
        (b'{"op": "explode"}\n', '"op" must be one of: ack, reset, shelve'),
        (b'{"op": "ack", "args": {"by": "zoe\\u001b[2J"}}\n', "args.by: "),
        (b'{"op": "shelve", "args": {"for_s": NaN}}\n', "args.for_s: "),
        (b'{"op": "reload", "args": {"file": "/etc/passwd"}}\n', "args.file: extra inputs"),
    ],
)
def test_what_is_no_request_is_answered_and_the_connection_goes_on(control, client, line, expected):
    answer = client.ask(line)
    assert answer["status"] == "error"
    assert expected in answer["error"]
    assert client.ask({"op": "hello"})["status"] == "ok"
    assert control.take() == []


def test_a_line_of_a_megabyte_ends_its_connection_and_no_other(control, client, connect):
    other = connect(control)
    with contextlib.suppress(OSError):  # it may hang up before it has read all
        client.socket.sendall(b'{"op": "' + b"a" * 1_000_000)
        assert f"more than {LINE_MAX_BYTES} bytes" in client.answer()["error"]
    assert other.ask({"op": "hello"})["status"] == "ok"


def test_more_requests_than_may_wait_are_refused_and_the_others_stay(control, connect):
    while len(control._asked) < WAITING_MAX:
        before = len(control._asked)
        connect(control).send({"op": "status"})
        assert eventually(lambda before=before: len(control._asked) > before)
    refused = connect(control).ask({"op": "status"})
    assert refused["error"] == f"{WAITING_MAX} requests wait already; try again later"
    assert len(taken(control, WAITING_MAX)) == WAITING_MAX


def test_an_answer_that_cannot_be_put_into_words_costs_its_connection_at_most(control, client, connect):
    def defect():
        raise ZeroDivisionError("a defect")

    client.send({"op": "status"})
    (asked,) = taken(control)
    asked.answer(defect)
    assert "could not be put into words: ZeroDivisionError" in client.answer()["error"]
    client.send({"op": "status"})
    (asked,) = taken(control)
    asked.answer(Reply(object()))
    assert client.answer() is None
    assert is_heard(connect(control))


def test_a_connection_on_which_nothing_is_said_is_closed(tmp_path, connect):
    control = ControlSocket(tmp_path / "run.sock", lambda: HELLO, idle_max_s=0.01)
    control.open()
    try:
        client = connect(control)
        assert client.answer() is None
    finally:
        control.close()


def test_only_our_user_may_ask(control):
    assert stat.S_IMODE(control.path.stat().st_mode) == 0o600


def test_a_socket_that_a_killed_run_left_behind_is_taken_over(tmp_path, connect):
    path = tmp_path / "run.sock"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    control = ControlSocket(path, lambda: HELLO)
    control.open()
    client = connect(control)
    assert client.ask({"op": "hello"})["status"] == "ok"
    control.close()


@pytest.mark.parametrize("kind", ["file", "alive"])
def test_what_is_there_and_is_no_left_socket_is_not_touched(tmp_path, kind):
    path = tmp_path / "run.sock"
    alive = socket.socket(socket.AF_UNIX)
    if kind == "file":
        path.write_text("mine")
    else:
        alive.bind(str(path))
        alive.listen()
    control = ControlSocket(path, lambda: HELLO)
    with pytest.raises(ControlError, match="cannot listen there: Address already in use"):
        control.open()
    control.close()
    assert path.exists()
    alive.close()


def test_closing_removes_the_socket_and_hangs_up(control, client):
    client.send({"op": "status"})
    taken(control)
    control.close()
    control.close()
    assert client.answer() is None
    assert not control.path.exists()
