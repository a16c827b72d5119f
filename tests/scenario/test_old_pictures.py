"""Each way in which a stream fails, once, with the whole program: no robot moves on what it shows.

A robot follows a ball that a real HTTP stream shows. Then the stream fails, and the ball is gone at the same moment.
"""

from __future__ import annotations

import math
import os
import random
import signal
import socket
import threading
import time
from collections import deque
from contextlib import contextmanager, suppress
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.simulation.camera import paint_ball
from stadimeter.testing.rig import eventually
from support.program_and_board import Rig
from support.simulated_run import LENS as LENS_TABLE
from support.slow_network import hand_on

pytestmark = pytest.mark.long

RATE_HZ = 30.0
PERIOD_S = 1 / RATE_HZ
VARIANTS = 900
"""Pictures that differ in their noise only; they come in turn after 30 s, and a run lasts for half of that."""

FOLLOWS_FOR_S, WATCHED_S = 1.5, 3.0
STOOD_WITHIN_S = 1.0
"""A quarter of that on a machine that does nothing else, and half of it over a slow link."""

LENS = CameraModel(width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=319.5, cy_px=239.5)
CAMERA = (
    '[camera]\ndriver = "opencv"\ndevice = "{address}"\n{latency}\n'
    + LENS_TABLE
    + '[targets.ball]\ndetector = "ball"\ndiameter = "20 cm"\nhsv = "29,86,6:64,255,255"\n'
)


def jpeg(image):
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()


@cache
def pictures(*, with_ball):
    """Return JPEGs of one scene, each with noise of its own."""
    scene = np.full((480, 640, 3), (96, 88, 80), np.uint8)
    scene[300:] = (70, 75, 85)
    if with_ball:
        paint_ball(scene, LENS, (0.0, 0.15, 2.5), 0.1)
    noise = np.random.default_rng(with_ball).normal(0, 2.0, (8, *scene.shape)).astype(np.int16)
    noisy = (np.roll(noise[n % 8], (7 * n, 11 * n), (0, 1)) + scene for n in range(VARIANTS))
    return [jpeg(np.clip(each, 0, 255).astype(np.uint8)) for each in noisy]


class Source:
    """What the camera of the stream sees, and what reaches whoever watches it.

    Attributes:
        ball_is_there: Whether pictures that are taken now show the ball.
        spoil: Makes of a whole JPEG what is sent of it.
        delay_s: How long a picture is on its way.
        stalled: Pictures are taken and wait, while this is set; then they are sent in a burst.
        newest: The pictures that were taken last.
        link_bytes_s: How many bytes a second the link carries; the rest waits in the sender's buffers.
        ends_packets: Whether packets of that link end with pictures, as a router's queue leaves them.
        is_kept: Whether pictures that wait outlive the connection, as in a relay.
    """

    def __init__(self):
        self.ball_is_there, self.spoil = True, lambda _number, data: data
        self.delay_s, self.stalled, self.is_kept = 0.0, threading.Event(), False
        self.link_bytes_s, self.ends_packets = math.inf, False
        self.newest = deque(maxlen=30)
        self.ended = threading.Event()
        self._waiting, self._number, self._next_s = deque(), 0, time.monotonic()

    def parts(self):
        """Yield what one client is sent, at its pace."""
        waiting = self._waiting
        if not self.is_kept:
            waiting.clear()
            self._next_s = time.monotonic()
        while not self.ended.is_set():
            while self._next_s <= time.monotonic():
                shown = pictures(with_ball=self.ball_is_there)
                self.newest.append(self.spoil(self._number, shown[self._number % VARIANTS]))
                waiting.append((self._next_s, self.newest[-1]))
                self._number, self._next_s = self._number + 1, self._next_s + PERIOD_S
            if self.stalled.is_set() or not waiting or waiting[0][0] + self.delay_s > time.monotonic():
                time.sleep(0.002)
                continue
            yield waiting.popleft()[1]
            if waiting and waiting[0][0] + self.delay_s < time.monotonic() - PERIOD_S:
                time.sleep(1 / 150)


@contextmanager
def served(source):
    """Serve a source as a multipart stream of JPEGs, as IP cameras do, over its link; yield the address."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            with suppress(OSError):
                for part in source.parts():
                    self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(part))
                    self.wfile.write(part + b"\r\n")

        def log_message(self, *_):
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    link = socket.create_server(("127.0.0.1", 0))

    def carry(client):
        with suppress(OSError), client, socket.create_connection(server.server_address) as sender:
            sender.sendall(client.recv(65536))
            hand_on(sender, client, lambda: source.link_bytes_s, source.ended, ends_packets=source.ends_packets)

    def accept():
        with suppress(OSError):
            while True:
                threading.Thread(target=carry, args=(link.accept()[0],), daemon=True).start()

    for serve in (server.serve_forever, accept):
        threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{link.getsockname()[1]}/stream"
    finally:
        source.ended.set()
        link.shutdown(socket.SHUT_RDWR)
        link.close()
        server.shutdown()
        server.server_close()


# Each makes the stream fail, or the program, once the robot follows; it returns when the last truly fresh picture was
# taken.


def lose_the_ball(source, _rig):
    source.ball_is_there = False
    return time.monotonic()


def cut(source, rig):
    source.spoil = lambda _number, data: data[: round(0.7 * len(data))] + b"\xff\xd9"
    return lose_the_ball(source, rig)


def repeat(count, *, of_two_sizes=False):
    """Send the newest pictures again and again, as a driver does that cycles its buffers; every other one smaller."""

    def fail(source, _rig):
        newest = list(source.newest)[-count:]
        if of_two_sizes:
            newest[::2] = [jpeg(cv2.resize(decoded(data), None, fx=0.5, fy=0.5)) for data in newest[::2]]
        failed_s = time.monotonic()
        source.spoil = lambda number, _data: newest[number % count]
        return failed_s

    return fail


def decoded(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def slow_down(share, *, ends_packets):
    """Leave the link a share of what the pictures need, and take the ball away up to 4 s later."""

    def fail(source, rig):
        source.ends_packets = ends_packets
        source.link_bytes_s = share * RATE_HZ * len(pictures(with_ball=True)[0])
        time.sleep(random.uniform(0, 4))  # noqa: S311 - another moment in each run
        return lose_the_ball(source, rig)

    return fail


def stall(seconds, *, is_kept=False):
    def fail(source, rig):
        source.is_kept = is_kept
        source.stalled.set()
        failed_s = time.monotonic()
        time.sleep(seconds)
        lose_the_ball(source, rig)
        source.stalled.clear()
        return failed_s

    return fail


def pause(source, rig):
    """Stop the program itself. Its base stops by itself meanwhile; what counts is what happens when it goes on."""
    os.kill(rig.program.pid, signal.SIGSTOP)
    time.sleep(10.0)
    lose_the_ball(source, rig)
    os.kill(rig.program.pid, signal.SIGCONT)
    return time.monotonic()


@pytest.mark.parametrize(
    "fail",
    [
        pytest.param(cut, id="cut to 70 %, end appended"),
        pytest.param(repeat(2), id="two old pictures in turn"),
        pytest.param(repeat(30), id="30 old pictures in turn"),
        pytest.param(repeat(2, of_two_sizes=True), id="two old pictures of two sizes in turn"),
        pytest.param(slow_down(0.5, ends_packets=False), id="link at 50 %"),
        pytest.param(slow_down(0.9, ends_packets=True), id="link at 90 %, packets end with pictures"),
        pytest.param(stall(0.9), id="stall of 0.9 s"),
        pytest.param(stall(3.0, is_kept=True), id="stall of 3 s, kept by the sender"),
        pytest.param(pause, id="program paused for 10 s"),
    ],
)
def test_no_robot_moves_on_pictures_that_are_not_now(fail):
    source = Source()
    with running(source, 'latency = "20 ms"') as rig:
        rig.wait_for("base 0.3")
        time.sleep(FOLLOWS_FOR_S)
        eventually(lambda: rig.board()["driven_mps"] > 0)  # a busy machine may have held up a picture just now
        failed_s = fail(source, rig)
        time.sleep(WATCHED_S)
        assert rig.board()["driven_mps"] == 0
        stood_after_s = rig.board()["stopped_at_s"] - failed_s
        assert stood_after_s <= STOOD_WITHIN_S, f"{stood_after_s:.2f} s: {rig.said}"


@pytest.mark.parametrize("latency", ["", 'latency = "2 s"'], ids=["unsaid", "stated"])
def test_no_robot_ever_moves_on_a_stream_that_lags_by_two_seconds(latency):
    source = Source()
    source.delay_s = 2.0
    with running(source, latency) as rig:
        time.sleep(10.0)
        assert rig.board() == {"driven_mps": 0.0, "stopped_at_s": 0.0}
        assert rig.program.poll() is None, rig.said


@contextmanager
def running(source, latency):
    for with_ball in (True, False):
        pictures(with_ball=with_ball)  # drawn before anything is timed
    with served(source) as address, Rig(60.0, CAMERA.format(address=address, latency=latency)) as rig:
        yield rig
