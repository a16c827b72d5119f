"""The links to the run and to the workbench: whatever those do, the page has an answer or a sentence."""

import asyncio
import socket
import sys
import threading
from contextlib import contextmanager

import pytest

from stadimeter.app.control.messages import Reply
from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.errors import PageError
from stadimeter.testing.rig import eventually
from stadimeter.web.links import RunLink, WorkbenchLink, command_of_workbench

# The link to the run: finds it, asks it, and says in a sentence why it cannot.


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


# The link to the workbench process: whatever that does, the page has an answer or a sentence.

ODD = """
import json, os, sys, time
for line in sys.stdin:
    asked = json.loads(line)
    if asked["op"] == "die":
        os._exit(3)
    if asked["op"] == "hang":
        time.sleep(600)
    if asked["op"] == "babble":
        print("no JSON", flush=True)
    elif asked["op"] == "refuse":
        print(json.dumps({"status": "error", "error": "no", "code": "conflict", "their_text": "a"}), flush=True)
    else:
        answer = {"status": "ok", "data": [os.getpid(), asked["args"]], "bytes": 3}
        print(json.dumps(answer) + "\\nabc", end="", flush=True)
"""
"""Stands for the process with all that may happen to it."""


def tell(story, command=(sys.executable, "-c", ODD), idle_max_s=60.0):
    """Run a story of a link, and return what it returns; at its end the process is gone."""

    async def begin():
        link = WorkbenchLink(command, idle_max_s)
        try:
            return await story(link)
        finally:
            process = link._process
            await link.close()
            assert process is None or process.returncode is not None

    return asyncio.run(begin())


def test_the_process_is_started_once_and_answers_with_bytes():
    async def story(link):
        return [await link.ask("echo", {"text": "é\n"}, 20) for _ in range(2)]

    first, second = tell(story)
    assert first.data[1] == {"text": "é\n"}
    assert first.attached == b"abc"
    assert first.data[0] == second.data[0]


@pytest.mark.parametrize(
    ("op", "wait_s", "code"),
    [("die", 20, "workbench-gone"), ("babble", 20, "workbench-gone"), ("hang", 0.1, "workbench-slow")],
)
def test_after_a_mishap_there_is_a_sentence_and_then_another_process(op, wait_s, code):
    async def story(link):
        before = await link.ask("echo", {}, 20)
        with pytest.raises(PageError) as refused:
            await link.ask(op, {}, wait_s)
        assert (refused.value.status, refused.value.code) == (503, code)
        assert (await link.ask("echo", {}, 20)).data[0] != before.data[0]

    tell(story)


def test_a_refusal_keeps_its_code_and_what_else_it_says():
    async def story(link):
        with pytest.raises(PageError) as refused:
            await link.ask("refuse", {}, 20)
        return refused.value

    error = tell(story)
    assert (error.status, error.code, error.details) == (409, "conflict", {"their_text": "a"})


def test_the_answer_to_one_who_hung_up_is_not_the_next_ones():
    async def story(link):
        await link.ask("echo", {}, 20)
        gone = asyncio.ensure_future(link.ask("echo", {"of": "gone"}, 20))
        await asyncio.sleep(0)
        gone.cancel()
        return await link.ask("echo", {"of": "next"}, 20)

    assert tell(story).data[1] == {"of": "next"}


def test_without_a_question_it_ends():
    async def story(link):
        await link.ask("echo", {}, 20)
        process = link._process
        assert await process.wait() == 0
        assert link._process is None or link._process is process

    tell(story, idle_max_s=0)


def test_a_command_that_is_not_there_is_a_sentence():
    async def story(link):
        with pytest.raises(PageError, match="cannot be started"):
            await link.ask("echo", {}, 20)

    tell(story, command=["/no/such/command"])


def test_the_real_one_is_asked_and_refuses_what_it_does_not_know(tmp_path):
    async def story(link):
        with pytest.raises(PageError, match="there is no operation 'nothing'"):
            await link.ask("nothing", {}, 60)
        return await link.ask("setup_operations.state", {}, 60)

    told = tell(story, command_of_workbench(tmp_path / "room.toml", None)).data
    assert told["folder"] == str(tmp_path)
