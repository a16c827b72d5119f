"""Watching a run over its socket: snapshots with the frames they belong to, whoever reads and however slowly."""

import json
import socket
import threading
from contextlib import contextmanager

import cv2
import numpy as np
import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.app.live.history import EVENTS_MAX
from stadimeter.app.live.snapshot import LiveFeed
from stadimeter.app.loop import Limits
from stadimeter.app.watching import SUBSCRIPTIONS_MAX, Subscriptions
from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.frame import Frame
from stadimeter.core.observation import FrameStamp
from stadimeter.testing.rig import eventually
from support.cycle_records import cycle_record
from support.live_rig import Rig


class Client:
    """Somebody who watches."""

    def __init__(self, path, op="subscribe", **args):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(120)
        self.socket.connect(str(path))
        self.file = self.socket.makefile("rb")
        self.socket.sendall(json.dumps({"op": op, "args": args}).encode() + b"\n")

    def answer(self):
        """Return a line and what follows it; None at the end."""
        line = self.file.readline()
        if not line:
            return None
        answer = json.loads(line, parse_constant=pytest.fail)
        answer["attached"] = self.file.read(answer.get("bytes", 0))
        return answer

    def close(self):
        self.file.close()
        self.socket.close()


class Watched:
    """A run that is made by hand, cycle by cycle, and its socket."""

    def __init__(self, path):
        self.clock = MonotonicClock()
        self.feed = LiveFeed(self.clock)
        self.subscriptions = Subscriptions(self.feed)
        self.control = ControlSocket(path, dict, watched=self.subscriptions)
        self.count = 0
        self.ended = threading.Event()
        self.image = None
        self.pending = ()
        self._clients = []

    def cycle(self, **changes):
        """Take in a frame whose grey counts it."""
        self.count += 1
        image = np.full((48, 64, 3), self.count % 200, np.uint8) if self.image is None else self.image
        now_s = self.clock.now_s()
        stamp = FrameStamp(sequence=self.count, captured_at_s=now_s)
        self.feed.history.add(
            cycle_record(now_s, frame=stamp, **changes), Frame(image=image, captured_at_s=now_s, sequence=self.count)
        )

    def goes_on(self):
        while not self.ended.wait(0.01):
            events, self.pending = self.pending, ()
            self.cycle(events=events)

    def connect(self, **args):
        self._clients.append(Client(self.control.path, **args))
        return self._clients[-1]

    def close(self):
        self.ended.set()
        for client in self._clients:
            client.close()
        self.control.close()


@pytest.fixture
def watched(tmp_path):
    watched = Watched(tmp_path / "run.sock")
    watched.control.open()
    yield watched
    watched.close()


@contextmanager
def running(watched):
    thread = threading.Thread(target=watched.goes_on)
    thread.start()
    try:
        yield
    finally:
        watched.ended.set()
        thread.join()


def pictured(client):
    """Return the first answer that has a picture."""
    while not (answer := client.answer())["attached"]:
        pass
    return answer


def event(number):
    return Event(
        kind=EventKind.RAISED, source="near", at_s=0.0, severity=Severity.INFO, reason="", sequence=number, by="zoe"
    )


@pytest.mark.long
def test_a_picture_comes_with_what_was_found_in_exactly_this_frame(tmp_path):
    rig = Rig(tmp_path)  # the grey of its pictures counts them
    control = ControlSocket(tmp_path / "run.sock", dict, watched=Subscriptions(LiveFeed(rig.clock, rig.loop.history)))
    control.open()
    thread = threading.Thread(target=rig.loop.run, args=(Limits(seconds=30),))
    thread.start()
    client = Client(control.path, image="plain", quality=95)
    try:
        for _ in range(5):
            answer = pictured(client)
            snapshot = answer["data"]
            grey = cv2.imdecode(np.frombuffer(answer["attached"], np.uint8), cv2.IMREAD_COLOR).mean()
            assert snapshot["frame"]["sequence"] % 250 == pytest.approx(grey, abs=0.9)
            (target,) = snapshot["targets"]
            assert target["detection"]["centre_px"] == [31.5, 23.5]
            if target["is_valid"]:
                assert target["distance_m"] == pytest.approx(2.0, abs=0.2)
    finally:
        rig.loop.end("enough")
        thread.join()
        client.close()
        control.close()


def test_the_newest_frame_is_sent_as_it_is_or_as_jpeg(watched):
    assert watched.connect(op="frame").answer()["error"] == "there is no picture yet"
    watched.cycle()
    raw = watched.connect(op="frame", encoding="raw").answer()
    assert raw["attached"] == bytes([1]) * 48 * 64 * 3
    told = {key: raw["data"][key] for key in ("width_px", "height_px", "subsampling", "optics", "source")}
    assert told == {"width_px": 64, "height_px": 48, "subsampling": "4:4:4", "optics": None, "source": ""}
    jpeg = watched.connect(op="frame", image="drawn").answer()["attached"]
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == (48, 64, 3)
    assert watched.subscriptions._pictures._made == {}


def test_without_a_new_frame_the_snapshot_goes_on_and_the_picture_does_not(watched):
    watched.cycle()
    client = watched.connect(image="plain")
    assert client.answer()["attached"]
    watched.feed.history.add(cycle_record(watched.clock.now_s(), frame=None), None)
    later = client.answer()
    assert later["attached"] == b""
    assert later["data"]["frame"]["sequence"] == 1


def test_a_snapshot_says_how_old_its_cycle_is_while_the_loop_hangs(watched):
    watched.cycle()
    client = watched.connect()
    first, second = (client.answer()["data"]["cycle_age_s"] for _ in range(2))
    assert second > first
    eventually(lambda: watched.cycle() or client.answer()["data"]["cycle_age_s"] < second)


@pytest.mark.long
def test_whoever_does_not_read_loses_snapshots_and_no_event_and_costs_the_others_nothing(watched):
    watched.image = np.random.default_rng(1).integers(0, 255, (480, 640, 3), np.uint8)  # too large for what waits
    with running(watched):
        slow, quick = watched.connect(image="plain", quality=95), watched.connect()
        for number in range(15):
            watched.pending += (event(number),)
            quick.answer()
        told, numbers = [], []
        while len(told) < 15:
            snapshot = slow.answer()["data"]
            told += [each["number"] for each in snapshot["events"]]
            numbers.append(snapshot["n"])
    assert told == list(range(15))
    assert len(numbers) < 8


def test_a_reader_that_comes_late_gets_the_newest_hundred_events_oldest_first(watched):
    for number in range(EVENTS_MAX + 50):
        watched.cycle(events=(event(number),))
    first = watched.connect().answer()["data"]
    assert [each["number"] for each in first["events"]] == list(range(EVENTS_MAX - 50, EVENTS_MAX + 50))
    assert first["events"][0]["by"] == "zoe"


@pytest.mark.long
def test_one_that_never_reads_is_hung_up_on_and_nothing_of_it_stays(tmp_path):
    watched = Watched(tmp_path / "run.sock")
    watched.control.idle_max_s = 0.2
    watched.control.open()
    try:
        with running(watched):
            watched.connect(image="plain")
            assert eventually(lambda: watched.subscriptions._all)
            assert eventually(lambda: not watched.subscriptions._all)
            assert eventually(lambda: watched.subscriptions._thread is None)
    finally:
        watched.close()


def test_more_subscriptions_than_a_run_serves_are_refused_in_words_and_the_connection_stays(watched):
    watched.cycle()
    for client in [watched.connect() for _ in range(SUBSCRIPTIONS_MAX)]:
        assert client.answer()["status"] == "ok"
    refused = watched.connect()
    assert refused.answer()["error"] == "16 subscriptions are the most that a run serves; end one first"
    refused.socket.sendall(b'{"op": "hello"}\n')
    assert refused.answer()["status"] == "ok"
