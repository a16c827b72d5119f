"""Whether a robot ever moves on pictures that are not now: whole runs of the program on streams that fail.

A robot follows a ball that a real HTTP (or UDP) stream shows. Then the stream fails, and the ball is gone at the same
moment. The base is an emulated firmware behind a pseudo-terminal of this process, which notes every motor command with
its time. Counted is how long after the last truly fresh picture the wheels were commanded to stand for good.

    python tests/benchmarks/old_pictures.py --runs 20
"""

from __future__ import annotations

import argparse
import math
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.app.clock import MonotonicClock
from stadimeter.core.camera_model import CameraModel
from stadimeter.simulation.camera import paint_ball
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.simulation.firmware import RosArduinoFirmware
from support.simulated_run import LENS as LENS_TABLE
from support.slow_network import hand_on

SIZE = (640, 480)
RATE_HZ = 30.0
PERIOD_S = 1 / RATE_HZ
VARIANTS = 900
"""Pictures that differ in their noise only; they come in turn after 30 s, and a run lasts for half of that."""

DISTANCE_M = 2.5
DRIVEN_S = 1.5
"""The robot follows for this long before the stream fails."""
WATCHED_S = 3.0
"""Motor commands are watched for this long afterwards."""
LIMIT_S = 0.25
SLOW_LINK_LIMIT_S = 0.52
"""Half a second beyond the stated latency."""

LENS = CameraModel(width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=319.5, cy_px=239.5)

CONFIGURATION = (
    """
[camera]
driver = "opencv"
device = "{address}"
{camera}
"""
    + LENS_TABLE
    + """
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[base]
driver = "ros-arduino-bridge"
port = "{port}"
wheel_diameter = "6.5 cm"
ticks_per_turn = 1440
track_width = "20 cm"
max_speed = "0.4 m/s"

[rules.follow]
actuator = "base"
follow = {{ distance = "1 m", max_speed = "0.3 m/s", search = "off" }}
"""
)


def now_s() -> float:
    """Return the time on the clock that a live run uses."""
    return MonotonicClock().now_s()


@cache
def pictures(*, with_ball: bool) -> list[bytes]:
    """Return JPEGs of one scene, each with noise of its own."""
    seed = 1 if with_ball else 2
    random_numbers = np.random.default_rng(seed)
    scene = np.full((SIZE[1], SIZE[0], 3), (96, 88, 80), np.uint8)
    scene[300:] = (70, 75, 85)
    if with_ball:
        paint_ball(scene, LENS, (0.0, 0.15, DISTANCE_M), 0.1)
    noise = random_numbers.normal(0, 2.0, (8, *scene.shape)).astype(np.int16)
    encoded = []
    for number in range(VARIANTS):
        noisy = np.roll(noise[number % 8], (7 * number, 11 * number), (0, 1)) + scene
        encoded.append(cv2.imencode(".jpg", np.clip(noisy, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 85])[1])
    return [bytes(each) for each in encoded]


class Base(RosArduinoFirmware):
    """An emulated base behind a pseudo-terminal, which notes what its motors are told."""

    def __init__(self) -> None:
        super().__init__(now_s())
        self.commands: list[tuple[float, int, int]] = []
        self.port = EmulatedPort(self, MonotonicClock())

    def _set_motor_speeds(self, left: int, right: int) -> bytes:
        self.commands.append((now_s(), left, right))
        return super()._set_motor_speeds(left, right)

    @property
    def has_moved(self) -> bool:
        """Whether any command was to move."""
        return any(left or right for _, left, right in self.commands)

    def stood_at_s(self, since_s: float) -> float:
        """Return when the wheels were told to stand after the last command to move; ``since_s`` if there was none."""
        moving = [
            index for index, (at_s, left, right) in enumerate(self.commands) if (left or right) and at_s > since_s
        ]
        if not moving:
            return since_s
        after = self.commands[moving[-1] + 1 :]
        return after[0][0] if after else now_s()


class Source:
    """What the camera of the stream sees, and what reaches whoever watches it.

    Attributes:
        ball_is_there: Whether pictures that are taken now show the ball.
        spoil: Makes of a whole JPEG what is sent of it.
        delay_s: How long a picture is on its way.
        stalled: Pictures are taken and wait, while this is set.
        burst_hz: How fast pictures that waited are sent.
        newest: The pictures that were taken last, up to 600.
        link_bytes_s: How many bytes a second the link carries; the rest waits in the sender's buffers.
        ends_packets: Whether packets of that link end with pictures, as a router's queue leaves them.
        kept: Whether pictures that wait outlive the connection, as in a relay.
    """

    def __init__(self) -> None:
        self.ball_is_there = True
        self.spoil: Callable[[int, bytes], bytes] = lambda _number, data: data
        self.delay_s = 0.0
        self.stalled = threading.Event()
        self.burst_hz = 150.0
        self.newest: deque[bytes] = deque(pictures(with_ball=True)[:2], maxlen=600)
        self.link_bytes_s = math.inf
        self.ends_packets = False
        self.kept = False
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._number, self._next_s = 0, now_s()
        self.ended = threading.Event()

    def parts(self) -> Iterator[bytes]:
        """Yield what one client is sent, at its pace."""
        waiting = self._waiting
        if not self.kept:
            waiting.clear()
            self._next_s = now_s()
        while not self.ended.is_set():
            while self._next_s <= now_s():
                shown = pictures(with_ball=self.ball_is_there)
                taken = self.spoil(self._number, shown[self._number % VARIANTS])
                self.newest.append(taken)
                waiting.append((self._next_s, taken))
                self._number, self._next_s = self._number + 1, self._next_s + PERIOD_S
            if self.stalled.is_set() or not waiting or waiting[0][0] + self.delay_s > now_s():
                time.sleep(0.002)
                continue
            yield waiting.popleft()[1]
            if waiting and waiting[0][0] + self.delay_s < now_s() - PERIOD_S:
                time.sleep(1 / self.burst_hz)


@contextmanager
def served(source: Source) -> Iterator[str]:
    """Serve a source as a multipart stream of JPEGs, as IP cameras do, and yield its address."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            with suppress(OSError):
                for part in source.parts():
                    self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(part))
                    self.wfile.write(part + b"\r\n")

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/stream"
    finally:
        source.ended.set()
        server.shutdown()
        server.server_close()


@contextmanager
def slow_link(source: Source) -> Iterator[str]:
    """Serve a source through a relay that carries as many bytes a second as the source says; yield the address."""
    with served(source) as address, socket.create_server(("127.0.0.1", 0)) as listening:
        host, port = urlsplit(address).hostname, urlsplit(address).port

        def carry(client: socket.socket) -> None:
            with suppress(OSError), client, socket.create_connection((host, port)) as sender:
                sender.sendall(client.recv(65536))
                hand_on(sender, client, lambda: source.link_bytes_s, source.ended, ends_packets=source.ends_packets)

        def accept() -> None:
            with suppress(OSError):
                while True:
                    threading.Thread(target=carry, args=(listening.accept()[0],), daemon=True).start()

        threading.Thread(target=accept, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}/stream"
        finally:
            source.ended.set()
            listening.shutdown(socket.SHUT_RDWR)


@contextmanager
def lossy_h264(source: Source, loss: float, seed: int) -> Iterator[str]:
    """Send a source as H.264 over UDP through a relay that loses a share of the packets; yield the address."""
    chance = random.Random(seed)  # noqa: S311 - the same packets are lost in each run of a seed
    relay = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    relay.bind(("127.0.0.1", 0))
    relay.settimeout(0.1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        target = free.getsockname()
    into = ["-f", "image2pipe", "-framerate", str(RATE_HZ), "-c:v", "mjpeg", "-i", "-"]
    codec = ["-c:v", "libx264", "-preset", "ultrafast", "-tune", "zerolatency", "-g", "60", "-pix_fmt", "yuv420p"]
    out = ["-f", "mpegts", f"udp://127.0.0.1:{relay.getsockname()[1]}?pkt_size=1316"]
    encoder = subprocess.Popen(["ffmpeg", "-v", "fatal", *into, *codec, *out], stdin=subprocess.PIPE)

    def forward() -> None:
        while not source.ended.is_set():
            with suppress(OSError):
                data = relay.recv(65536)
                if chance.random() >= loss:
                    relay.sendto(data, target)

    def feed() -> None:
        with suppress(OSError, ValueError):
            for part in source.parts():
                encoder.stdin.write(part)
                encoder.stdin.flush()

    threads = [threading.Thread(target=each, daemon=True) for each in (forward, feed)]
    for thread in threads:
        thread.start()
    try:
        yield f"udp://127.0.0.1:{target[1]}?fifo_size=50000&overrun_nonfatal=1"
    finally:
        source.ended.set()
        encoder.kill()
        encoder.wait()
        with suppress(OSError):
            encoder.stdin.close()
        for thread in threads:
            thread.join()
        relay.close()


class Failure(Struct, frozen=True):
    """A way to fail.

    Attributes:
        name: What it is called in the table.
        fail: Makes the stream, or the program with this process number, fail; called once the robot follows. It
            returns when the last truly fresh picture was taken.
        camera: What stands in the camera's table.
        moves: Whether the robot may follow at all before the failure.
        prepare: Changes the source before the run.
        loss: The share of packets that is lost; None for an HTTP stream.
        is_slow_link: Whether the stream goes over a link of a limited rate, where 0.5 s are allowed and not `LIMIT_S`.
    """

    name: str
    fail: Callable[[Source, int], float]
    camera: str = 'latency = "20 ms"'
    moves: bool = True
    prepare: Callable[[Source], None] = lambda _source: None
    loss: float | None = None
    is_slow_link: bool = False


def _cut(share: float, *, with_end: bool = False) -> Callable[[Source, int], float]:
    def fail(source: Source, _process: int) -> float:
        source.ball_is_there = False
        source.spoil = lambda _number, data: data[: round(share * len(data))] + (b"\xff\xd9" if with_end else b"")
        return now_s()

    return fail


def _repeat(count: int, *, sizes: bool = False) -> Callable[[Source, int], float]:
    """Send the newest pictures again and again, as a driver does that cycles its buffers; every other one smaller."""

    def fail(source: Source, _process: int) -> float:
        newest = list(source.newest)[-count:]
        if sizes:
            newest[::2] = [_smaller(data) for data in newest[::2]]
        failed_s = now_s()
        source.spoil = lambda number, _data: newest[number % count]
        return failed_s

    return fail


def _smaller(data: bytes) -> bytes:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    return cv2.imencode(".jpg", cv2.resize(image, None, fx=0.5, fy=0.5), [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()


def _end(source: Source) -> None:
    source.ends_packets = True


def _slow(share: float) -> Callable[[Source, int], float]:
    """Leave the link a share of what the pictures need, and take the ball away up to 4 s later."""

    def fail(source: Source, process: int) -> float:
        source.link_bytes_s = share * RATE_HZ * len(pictures(with_ball=True)[0])
        time.sleep(random.Random(process).uniform(0, 4))  # noqa: S311 - another moment in each run
        source.ball_is_there = False
        return now_s()

    return fail


def _keep(source: Source) -> None:
    source.kept = True


def _lose_the_ball(source: Source, _process: int) -> float:
    source.ball_is_there = False
    return now_s()


def _stall(seconds: float) -> Callable[[Source, int], float]:
    def fail(source: Source, _process: int) -> float:
        source.stalled.set()
        failed_s = now_s()
        time.sleep(seconds)
        source.ball_is_there = False
        source.stalled.clear()
        return failed_s

    return fail


def _pause(seconds: float) -> Callable[[Source, int], float]:
    """Stop the program itself. Its base stops by itself meanwhile; what counts is what happens when it goes on."""

    def fail(source: Source, process: int) -> float:
        os.kill(process, signal.SIGSTOP)
        time.sleep(seconds)
        source.ball_is_there = False
        os.kill(process, signal.SIGCONT)
        return now_s()

    return fail


def _late(source: Source) -> None:
    source.delay_s = 2.0


FAILURES = (
    *(Failure(f"cut to {100 * share:.0f} %", _cut(share)) for share in (0.1, 0.4, 0.7, 0.95)),
    *(
        Failure(f"cut to {100 * share:.0f} %, end appended", _cut(share, with_end=True))
        for share in (0.1, 0.4, 0.7, 0.95)
    ),
    Failure("two old pictures in turn", _repeat(2)),
    Failure("30 old pictures in turn", _repeat(30)),
    Failure("two old pictures of two sizes in turn", _repeat(2, sizes=True)),
    *(Failure(f"link at {100 * share:.0f} %", _slow(share), is_slow_link=True) for share in (0.5, 0.7, 0.9)),
    *(
        Failure(
            f"link at {100 * share:.0f} %, packets end with pictures", _slow(share), is_slow_link=True, prepare=_end
        )
        for share in (0.5, 0.7, 0.9)
    ),
    Failure("H.264 over UDP, 18 % lost", _lose_the_ball, moves=False, loss=0.18),
    Failure("lag of 2 s, unsaid", _lose_the_ball, camera="", moves=False, prepare=_late),
    Failure("lag of 2 s, stated", _lose_the_ball, camera='latency = "2 s"', moves=False, prepare=_late),
    Failure("stall of 0.9 s", _stall(0.9)),
    Failure("stall of 3 s, kept by the sender", _stall(3.0), prepare=_keep),
    Failure("program paused for 10 s", _pause(10.0)),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one run did.

    Attributes:
        failure: The failure.
        followed: Whether the robot moved before it.
        stood_after_s: How long after the last fresh picture the wheels were told to stand for good.
        output: What the program printed.
    """

    failure: Failure
    followed: bool
    stood_after_s: float
    output: str = field(repr=False, default="")

    @property
    def is_good(self) -> bool:
        """Whether the robot stood in time, and the run shows anything at all."""
        limit_s = SLOW_LINK_LIMIT_S if self.failure.is_slow_link else LIMIT_S if self.failure.moves else 0.0
        return self.followed is self.failure.moves and self.stood_after_s <= limit_s


def run_once(failure: Failure, seed: int, folder: Path) -> Outcome:
    """Run the program once on a stream that fails."""
    for with_ball in (True, False):
        pictures(with_ball=with_ball)  # drawn before anything is timed
    with ExitStack() as closing:
        source = Source()
        failure.prepare(source)
        serve = slow_link if failure.is_slow_link else served
        stream = serve(source) if failure.loss is None else lossy_h264(source, failure.loss, seed)
        address = closing.enter_context(stream)
        base = Base()
        closing.callback(base.port.close)
        configuration = folder / f"run-{seed}.toml"
        configuration.write_text(
            CONFIGURATION.format(address=address, port=base.port.path, camera=failure.camera), encoding="utf-8"
        )
        command = [sys.executable, "-m", "stadimeter", "run", str(configuration), "--no-state"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        closing.callback(process.kill)
        _wait(lambda: base.has_moved or process.poll() is not None, 12.0 if failure.moves else 7.0)
        time.sleep(DRIVEN_S + random.Random(seed).uniform(0, 0.2))  # noqa: S311 - likewise
        followed = base.has_moved
        failed_s = failure.fail(source, process.pid)
        time.sleep(WATCHED_S)
        stood_s = base.stood_at_s(failed_s)
        process.terminate()
        try:
            output, _ = process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            output, _ = process.communicate()
        return Outcome(failure, followed, stood_s - failed_s, output)


def _wait(is_true: Callable[[], bool], at_most_s: float) -> None:
    until_s = now_s() + at_most_s
    while not is_true() and now_s() < until_s:
        time.sleep(0.02)


def main() -> None:
    """Run every failure as often as asked, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--runs", type=int, default=20, help="of each failure")
    parser.add_argument("--at-once", type=int, default=2, help="runs side by side")
    parser.add_argument("--only", default="", help="failures whose names contain this")
    parser.add_argument("--show", action="store_true", help="print what a run that failed printed")
    arguments = parser.parse_args()
    failures = [
        each for each in FAILURES if arguments.only in each.name and (each.loss is None or shutil.which("ffmpeg"))
    ]
    print("| failure | runs | followed before | stood after, median | longest | within its limit |")
    print("| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(arguments.at_once) as pool:
        for failure in failures:
            outcomes = list(pool.map(lambda seed: run_once(failure, seed, Path(folder)), range(arguments.runs)))  # noqa: B023
            times = sorted(outcome.stood_after_s for outcome in outcomes)
            followed, good = sum(each.followed for each in outcomes), sum(each.is_good for each in outcomes)
            cells = (
                f"{len(times)} | {followed} | {1e3 * times[len(times) // 2]:.0f} ms | {1e3 * times[-1]:.0f} ms | {good}"
            )
            print(f"| {failure.name} | {cells} |", flush=True)
            for outcome in outcomes:
                if arguments.show and not outcome.is_good:
                    print(outcome.output)


if __name__ == "__main__":
    main()
