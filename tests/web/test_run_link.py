"""The link to the run: finds it, asks it, and says in a sentence why it cannot."""

import asyncio
import socket
import threading
from contextlib import contextmanager

import pytest

from stadimeter.app.control.messages import Reply
from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.errors import PageError
from stadimeter.testing.rig import eventually
from stadimeter.web.links import RunLink


@contextmanager
def listening(path, configuration):
    control = ControlSocket(path, lambda: {"configuration": str(configuration), "pid": 7})
    control.open()
    try:
        yield control
    finally:
        control.close()


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Where runs listen, with another one that must not be asked."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    folder = tmp_path / "stadimeter"
    folder.mkdir(mode=0o700)
    with listening(folder / "other.sock", tmp_path / "other.toml"):
        yield folder


def hello(link):
    return asyncio.run(link.ask("hello")).data["configuration"]


def test_it_finds_the_run_of_its_configuration_among_others(places, tmp_path):
    ours = tmp_path / "room.toml"
    with listening(places / "room.sock", ours):
        assert hello(RunLink(ours)) == str(ours)


def test_without_its_run_it_says_so_and_asks_no_other(places, tmp_path):
    with pytest.raises(PageError, match="no instance runs with") as refused:
        hello(RunLink(tmp_path / "room.toml"))
    assert (refused.value.status, refused.value.code) == (503, "no-run")
    assert not any(word in str(refused.value) for word in ("other", ".sock", "process"))  # of no one else's run


def test_it_finds_the_run_again_where_it_listens_now(places, tmp_path):
    ours = tmp_path / "room.toml"
    link = RunLink(ours)
    with listening(places / "room.sock", ours):
        assert hello(link) == str(ours)
    with listening(places / "room.sock", tmp_path / "else" / "room.toml"), listening(places / "room-9.sock", ours):
        assert hello(link) == str(ours)


def test_a_refusal_is_in_the_words_of_the_run(places, tmp_path):
    link = RunLink(tmp_path / "room.toml", places / "other.sock")
    with pytest.raises(PageError, match="one of: ") as refused:
        asyncio.run(link.ask("fly"))
    assert (refused.value.status, refused.value.code) == (400, "refused")


def test_what_is_nested_too_deeply_to_be_sent_is_refused(places, tmp_path):
    deep = []
    for _ in range(100_000):
        deep = [deep]
    link = RunLink(tmp_path / "room.toml", places / "other.sock")
    with pytest.raises(PageError, match="nested too deeply"):
        asyncio.run(link.ask("hello", {"deep": deep}))


def test_a_loop_that_does_not_answer_is_not_waited_for(places, tmp_path):
    link = RunLink(tmp_path / "room.toml", places / "other.sock")
    with pytest.raises(PageError, match="does it hang"):
        asyncio.run(link.ask("status", wait_s=0.05))


def test_an_answer_comes_from_the_loop(places, tmp_path):
    ours = tmp_path / "room.toml"
    with listening(places / "room.sock", ours) as control:

        def loop():
            asked = eventually(control.take)
            asked[0].answer(Reply({"words": "done"}))

        thread = threading.Thread(target=loop)
        thread.start()
        assert asyncio.run(RunLink(ours).ask("ack", {"rule": "far"})).data == {"words": "done"}
        thread.join()


@pytest.mark.parametrize(
    "said", [b"", b"nonsense\n", b'{"status": "ok", "bytes": -1}\n', b'{"status": "ok", "bytes": 9}\nx', b"[]\n"]
)
def test_what_is_no_run_is_a_sentence(tmp_path, said):
    path = tmp_path / "odd.sock"
    tmp_path.chmod(0o700)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()

        def answer():
            connection, _ = listener.accept()
            with connection:
                connection.recv(1000)
                connection.sendall(said)

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(PageError, match="is no run"):
            asyncio.run(RunLink(tmp_path / "room.toml", path).ask("status"))
        thread.join()


def test_a_socket_where_anybody_may_write_is_not_asked(tmp_path):
    tmp_path.chmod(0o777)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "open.sock"))
        listener.listen()
        with pytest.raises(PageError, match="others may write there"):
            asyncio.run(RunLink(tmp_path / "room.toml", tmp_path / "open.sock").ask("status"))
