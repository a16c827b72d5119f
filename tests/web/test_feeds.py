"""What browsers that watch are given, and many of them that behave badly: nothing crashes, and nothing grows."""

import asyncio
import contextlib
import json
import random
import socket
import socketserver
import threading
import time
from pathlib import Path

import pytest

from stadimeter.app.control.client import encode_answer
from stadimeter.errors import PageError
from stadimeter.testing.rig import eventually
from stadimeter.web import serving
from stadimeter.web.links import PageAnswer
from stadimeter.web.page import SAMPLES_KEPT_S, Feed
from stadimeter.web.passwords import PasswordFile
from stadimeter.web.routes import PAGE_OPERATIONS
from support.browser import ROOM, served
from support.page import OPERATE, ServedPage, quicken, served_page

# What browsers that watch are given: the newest, and of what they missed the events and the distances.


class ScriptedRun:
    """A run as a feed sees it: what it says, and when it ends."""

    def __init__(self):
        self.subscriptions = 0
        self.open = 0
        self.says = asyncio.Queue()

    async def subscription(self, args):
        self.subscriptions += 1
        self.open += 1
        try:
            while True:
                said = await self.says.get()
                if isinstance(said, Exception):
                    raise said
                yield said
        finally:
            self.open -= 1


def snapshot(number, events=(), samples=(), started=1.0):
    """What the run says at a time: its events and distances are those since the time before."""
    data = {
        "n": number,
        "run": {"started_unix_s": started},
        "events": [{"number": each} for each in events],
        "samples": {"ball": [[at_s, 1.0, 0.1] for at_s in samples]},
    }
    return PageAnswer(data, b"jpeg %d" % number)


async def settle():
    for _ in range(20):
        await asyncio.sleep(0)


def told(message):
    data = json.loads(message.snapshot)
    return data["n"], [event["number"] for event in data["events"]], [at_s for at_s, *_ in data["samples"]["ball"]]


@pytest.fixture
def told_by(monkeypatch):
    """Return a function that runs a story of a run and a feed."""
    monkeypatch.setattr("stadimeter.web.page.RETRY_S", 0)

    def tell(story):
        async def begin():
            run = ScriptedRun()
            feed = Feed(run, "plain")
            await story(run, feed)
            feed.close()
            await settle()
            assert run.open == 0

        asyncio.run(begin())

    return tell


def test_whoever_comes_while_the_run_hangs_is_told_how_old_the_last_message_is(told_by, monkeypatch):
    now_s = [50.0]
    monkeypatch.setattr("stadimeter.web.page.time.monotonic", lambda: now_s[0])

    async def story(run, feed):
        early, late = feed.watch(), feed.watch()
        first = asyncio.ensure_future(anext(early))
        await settle()
        await run.says.put(snapshot(1))
        assert json.loads((await first).snapshot)["waited_s"] == 0.0
        now_s[0] += 7.5
        assert json.loads((await anext(late)).snapshot)["waited_s"] == 7.5
        for each in (early, late):
            await each.aclose()

    told_by(story)


def test_many_watch_and_the_run_is_asked_once(told_by):
    async def story(run, feed):
        watchers = [feed.watch() for _ in range(20)]
        first = [asyncio.ensure_future(anext(each)) for each in watchers]
        await settle()
        await run.says.put(snapshot(1, events=[7], samples=[0.1]))
        messages = [await each for each in first]
        assert run.subscriptions == 1
        assert all(told(message) == (1, [7], [0.1]) for message in messages)
        assert {message.picture for message in messages} == {b"jpeg 1"}
        for each in watchers:
            await each.aclose()
        await settle()
        assert run.open == 0

    told_by(story)


def test_who_is_slow_loses_pictures_and_neither_events_nor_distances(told_by):
    async def story(run, feed):
        quick, slow = feed.watch(), feed.watch()
        waiting = [asyncio.ensure_future(anext(each)) for each in (quick, slow)]
        for number in range(1, 6):
            await run.says.put(snapshot(number, events=[number], samples=[number / 10]))
            await settle()
            assert told(await waiting[0]) == (number, [number], [number / 10])
            waiting[0] = asyncio.ensure_future(anext(quick))
            await settle()
        assert told(await waiting[1]) == (1, [1], [0.1])
        assert told(await anext(slow)) == (5, [2, 3, 4, 5], [0.2, 0.3, 0.4, 0.5])
        waiting[0].cancel()

    told_by(story)


def test_who_comes_late_is_told_what_was_before(told_by):
    async def story(run, feed):
        early = feed.watch()
        for number in (1, 2, 3):
            await run.says.put(snapshot(number, events=[number], samples=[number]))
            await anext(early)
        assert told(await anext(feed.watch())) == (3, [1, 2, 3], [1, 2, 3])

    told_by(story)


def test_what_the_run_repeats_at_a_new_subscription_is_told_once(told_by):
    async def story(run, feed):
        watcher = feed.watch()
        await run.says.put(snapshot(1, events=[1, 2], samples=[1, 2]))
        await anext(watcher)
        await run.says.put(PageError(503, "no-run", "the run has ended"))
        assert json.loads((await anext(watcher)).snapshot) == {"gone": "the run has ended", "code": "no-run"}
        await run.says.put(snapshot(9, events=[1, 2, 3], samples=[1, 2, 3]))
        assert told(await anext(watcher)) == (9, [3], [3])
        assert run.subscriptions == 2

    told_by(story)


def test_of_a_run_that_was_started_anew_all_is_told(told_by):
    async def story(run, feed):
        watcher = feed.watch()
        await run.says.put(snapshot(1, events=[1, 2], samples=[100, 200]))
        await anext(watcher)
        await run.says.put(PageError(503, "no-run", "the run has ended"))
        await anext(watcher)
        await run.says.put(snapshot(1, events=[1], samples=[1], started=2.0))
        assert told(await anext(watcher)) == (1, [1], [1])

    told_by(story)


def test_what_is_remembered_is_bounded(told_by):
    async def story(run, feed):
        watcher = feed.watch()
        for second in range(900):
            await run.says.put(snapshot(second, events=[second], samples=[float(second)]))
            await anext(watcher)
        number, events, samples = told(await anext(feed.watch()))
        assert (number, events) == (899, list(range(800, 900)))
        assert samples == [float(second) for second in range(round(899 - SAMPLES_KEPT_S), 900)]

    told_by(story)


# Many browsers, one that never reads, and requests that make no sense: nothing crashes, and nothing grows.

LIVE = b"GET /api/v1/live?image=%s HTTP/1.1\r\nHost: localhost\r\n\r\n"
PICTURE = b"\xff\xd8" + 60_000 * b"p"


class Talkative(socketserver.StreamRequestHandler):
    """A run that sends snapshots as fast as they are taken."""

    def handle(self):
        while line := self.rfile.readline():
            if b'"subscribe"' not in line:
                self.wfile.write(encode_answer({"status": "error", "error": "no"}))
                continue
            number = 0
            while not self.server.is_ended:
                number += 1
                data = {"n": number, "run": {"started_unix_s": 1.0}, "events": [], "samples": {}}
                try:
                    self.wfile.write(encode_answer({"status": "ok", "data": data}, PICTURE))
                except OSError:
                    return
                time.sleep(0.002)


@pytest.fixture
def talkative(tmp_path):
    class Server(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
        is_ended = False

    tmp_path.chmod(0o700)
    with Server(str(tmp_path / "run.sock"), Talkative) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        yield tmp_path / "run.sock"
        server.is_ended = True
        server.shutdown()
        thread.join()


def connected(port, small=False):
    connection = socket.socket()
    if small:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.settimeout(120)
    connection.connect(("127.0.0.1", port))
    return connection


def read_some(connection, size):
    while size > 0:
        got = connection.recv(65536)
        assert got, "the page hung up on one who reads"
        size -= len(got)


@pytest.mark.long
def test_one_who_never_reads_holds_nobody_up_and_is_hung_up_on(tmp_path, talkative, monkeypatch):
    monkeypatch.setattr(serving, "STUCK_MAX_S", 2.0)
    with served_page(tmp_path, socket=talkative) as site:
        feed = site.page.feeds["plain"]
        with connected(site.port, small=True) as deaf, connected(site.port) as quick:
            quick.sendall(LIVE % b"plain")
            eventually(lambda: feed._watchers == 1)
            reading = threading.Event()

            def read():
                while not reading.is_set():
                    read_some(quick, 1_000_000)

            thread = threading.Thread(target=read)
            thread.start()
            deaf.sendall(LIVE % b"plain")
            eventually(lambda: feed._watchers == 2)
            eventually(lambda: feed._watchers == 1)  # the kernel gave the deaf one up, and the other still reads
            reading.set()
            thread.join()
        eventually(lambda: feed._watchers == 0 and feed._task is None)


def memory_kb(pid, key="VmRSS"):
    with Path(f"/proc/{pid}/status").open() as status:
        return next(int(line.split()[1]) for line in status if line.startswith(key))


@pytest.mark.long
def test_the_process_is_small_with_three_who_watch_and_one_who_logs_in(tmp_path):
    """Its greatest size so far, with passwords hashed at their full cost."""
    PasswordFile(tmp_path / "stadimeter.passwords").set("operate", OPERATE)
    with served(tmp_path, ROOM, "--address", "127.0.0.1") as here, contextlib.ExitStack() as stack:
        site = ServedPage(None, int(here.url.rpartition(":")[2]))
        assert site.log_in(OPERATE).status == 303
        eventually(lambda: site.get("/api/v1/session").data["run"]["is_running"])
        (cookie,) = (f"{name}={value}".encode() for name, value in site.cookies.items())
        crowd = [stack.enter_context(connected(site.port)) for _ in range(3)]
        for each in crowd:
            each.sendall((LIVE % b"drawn").replace(b"\r\n\r\n", b"\r\nCookie: " + cookie + b"\r\n\r\n"))
            read_some(each, 500_000)
        assert site.get("/api/v1/configuration").status == 200
        assert memory_kb(here.page.pid, "VmHWM") <= 50_000


@pytest.mark.long
@pytest.mark.timeout(180)
def test_two_hundred_watch_a_real_run_and_one_of_them_never_reads(tmp_path):
    """In processes of their own, so that the page's memory is its own."""
    with served(tmp_path) as here, contextlib.ExitStack() as stack:
        port = int(here.url.rpartition(":")[2])
        eventually(lambda: is_running(port))
        deaf = stack.enter_context(connected(port, small=True))
        deaf.sendall(LIVE % b"plain")
        crowd = [stack.enter_context(connected(port)) for _ in range(200)]
        for each in crowd:
            each.sendall(LIVE % b"none")
        for each in crowd:
            read_some(each, 30_000)
        before_kb = memory_kb(here.page.pid)
        for _ in range(5):
            for each in crowd:
                read_some(each, 20_000)
        assert memory_kb(here.page.pid) - before_kb < 2_000
        assert is_running(port)


def is_running(port):
    with connected(port) as connection:
        connection.sendall(b"GET /api/v1/session HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        return b'"is_running":true' in b"".join(iter(lambda: connection.recv(65536), b""))


WORDS = rb"""GET POST PUT DELETE / // %2e%2e/ .. /static/ /api/v1/ ?image= ?at_s=nan ?at_s=1e999 &width_px=-1
%00 %ff '"<> {x}"""
WORDS = [*WORDS.split(), b"", b"\x00", b"\xff\xfe", b" "]
LINES = rb"""Host: localhost
Host: evil
Host:
Origin: null
Origin: http://[
Range: bytes=9-1
Content-Length: 5
Content-Length: -1
Content-Length: 99999999999
Transfer-Encoding: chunked
Content-Type: application/json
Expect: 100-continue
Sec-Fetch-Site: same-origin
X-Forwarded-Proto: https""".splitlines()
LINES += [b"X\x00: y", b"Cookie: a=b; \xff=\xfe;;=", b"Cookie: " + b"x" * 4000]
LINES += [b"Upgrade: websocket\r\nConnection: upgrade"]
BODIES = [b"", b"{}", b"[]", b"{", b'{"rule": {}}', b'{"by": 1e999}', b"0\r\n\r\n", b"fffffffff\r\n", b"[" * 3000]


def nonsense(chance):
    """Return a request that is nearly one."""
    path = chance.choice([place.path.encode() for place in PAGE_OPERATIONS] + WORDS)
    path += b"".join(chance.choices(WORDS, k=chance.randrange(3)))
    path = path.replace(b"/live", b"/life").replace(b"stream.", b"dream.")  # which end when we hang up, and not before
    lines = [b"Host: localhost"] * chance.randrange(2) + chance.choices(LINES, k=chance.randrange(5))
    head = b" ".join([chance.choice(WORDS[:6]), path, b"HTTP/1.1"])
    text = b"\r\n".join([head, *lines, b"Connection: close", b"", chance.choice(BODIES)])
    if chance.random() < 0.2:
        place = chance.randrange(len(text))
        text = text[:place] + chance.randbytes(3) + text[place + chance.randrange(4) :]
    return text


@pytest.mark.parametrize("count", [400, pytest.param(10_000, marks=[pytest.mark.long, pytest.mark.timeout(1800)])])
def test_requests_that_make_no_sense_do_no_harm(tmp_path, monkeypatch, count):
    quicken(monkeypatch)
    monkeypatch.setattr(serving, "IDLE_MAX_S", 0.4)
    chance = random.Random(20)  # noqa: S311
    with served_page(tmp_path, OPERATE) as site:
        site.log_in(OPERATE)
        (cookie,) = (f"Cookie: {name}={value}".encode() for name, value in site.cookies.items())
        monkeypatch.setattr(site.page.workbench, "ask", refused)  # it has a test of its own, and takes long
        statuses = set()
        for number in range(count):
            text = nonsense(chance)
            if number % 2:
                text = text.replace(b"Connection: close", cookie + b"\r\nConnection: close", 1)
            statuses.add(sent(site.port, text))
        assert site.get("/api/v1/session").status == 200
        eventually(lambda: len(threading.enumerate()) < 30)
    assert statuses >= {b"400", b"401", b"405"}
    assert b"500" not in statuses


async def refused(*_):
    from stadimeter.errors import PageError

    raise PageError(503, "busy", "not now")


def sent(port, text):
    """Send bytes, and return the status that they are answered with; empty if the page hung up."""
    with connected(port) as connection, contextlib.suppress(OSError):
        connection.sendall(text)
        connection.shutdown(socket.SHUT_WR)
        answer = connection.recv(65536)
        return answer[9:12] if answer.startswith(b"HTTP/1.1 ") else b""
    return b""


def test_a_message_of_the_run_that_makes_no_sense_ends_its_subscription_and_no_more(tmp_path, monkeypatch):
    monkeypatch.setattr("stadimeter.web.page.RETRY_S", 0)
    chance = random.Random(20)  # noqa: S311
    said = [b"\n", b"{}\n", b"[]\n", b"null\n", b"\xff\n"]
    said += [b'{"status":"ok"}\n', b'{"status":"ok","data":[],"bytes":2}\nxx']
    for key in ("run", "events", "samples", "n") * 8:
        value = chance.choice([None, 1, "x", [1], {"a": 1}, {"a": [[None]]}])
        said.append(json.dumps({"status": "ok", "data": {key: value}}).encode() + b"\n")

    class Odd(socketserver.StreamRequestHandler):
        def handle(self):
            self.rfile.readline()
            self.wfile.write(said.pop() if said else encode_answer({"status": "ok", "data": {"n": "sound"}}))

    tmp_path.chmod(0o700)
    with socketserver.ThreadingUnixStreamServer(str(tmp_path / "run.sock"), Odd) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        with served_page(tmp_path, socket=tmp_path / "run.sock") as site, connected(site.port) as connection:
            connection.sendall(LIVE % b"none")
            seen = b""
            while b'"sound"' not in seen:
                got = connection.recv(65536)
                assert got, seen[-500:]
                seen += got
        server.shutdown()
        thread.join()
