"""H.264 over UDP from a real sender, with packets that get lost and a sender that is stopped."""

from __future__ import annotations

import signal
import socket
import subprocess
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from support.programs import needs

pytestmark = [
    pytest.mark.long,
    needs("ffmpeg"),
]

PICTURES = "testsrc=size=320x240:rate=30,noise=alls=6:allf=t"
CODEC = ["-c:v", "libx264", "-preset", "ultrafast", "-tune", "zerolatency", "-pix_fmt", "yuv420p", "-g", "15"]
PATIENCE_S = 120.0


class Air:
    """Passes datagrams on, and loses some.

    Attributes:
        loss: The part that gets lost.
        passed: How many were passed on.
    """

    def __init__(self) -> None:
        self.loss, self.passed = 0.0, 0
        self._in, self._out = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._in.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self._to = free.getsockname()
        self.entry, self.exit = (f"udp://127.0.0.1:{port}" for port in (self._in.getsockname()[1], self._to[1]))
        self._in.settimeout(0.2)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._pass_on)
        self._thread.start()

    def _pass_on(self) -> None:
        rng = np.random.default_rng(9)
        while not self._ended.is_set():
            try:
                data = self._in.recv(65536)
            except TimeoutError:
                continue
            if rng.random() >= self.loss:
                self._out.sendto(data, self._to)
                self.passed += 1

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._in.close()
        self._out.close()


@pytest.fixture
def air() -> Iterator[Air]:
    air = Air()
    yield air
    air.close()


@pytest.fixture
def sender(air: Air) -> Iterator[subprocess.Popen[bytes]]:
    source = ["-re", "-f", "lavfi", "-i", PICTURES]
    output = ["-f", "mpegts", f"{air.entry}?pkt_size=1316"]
    process = subprocess.Popen(["ffmpeg", "-v", "fatal", "-nostdin", *source, *CODEC, *output])
    yield process
    process.kill()
    process.wait()


@pytest.fixture
def camera(air: Air, sender: subprocess.Popen[bytes]) -> Iterator[OpenCvCamera]:
    options = {"device": air.exit, "latency": "100 ms", "read_timeout": "5 s"}
    camera = OpenCvCamera(OpenCvOptions.model_validate(options), MonotonicClock())
    camera.open()
    yield camera
    camera.close()


def ages_s(camera: OpenCvCamera, count: int) -> list[float]:
    clock = MonotonicClock()
    captured_s = (camera.read().captured_at_s for _ in range(count))
    return [-at_s + clock.now_s() for at_s in captured_s]


def test_a_stream_that_loses_packets_goes_on_and_nothing_moves_on_it(air: Air, camera: OpenCvCamera) -> None:
    ages_s(camera, 10)
    air.loss = 0.18
    assert len(ages_s(camera, 20)) == 20
    assert "accept_lossy_stream" in camera.not_for_motion


def test_what_waited_in_a_stopped_sender_is_as_old_as_its_time_stamps_say(
    camera: OpenCvCamera, sender: subprocess.Popen[bytes]
) -> None:
    before_s = min(ages_s(camera, 30))
    sender.send_signal(signal.SIGSTOP)
    with pytest.raises(subprocess.TimeoutExpired):
        sender.wait(0.9)
    sender.send_signal(signal.SIGCONT)
    after_s = ages_s(camera, 90)
    assert max(after_s) > before_s + 0.6
    assert min(after_s[-30:]) < before_s + 0.2
    assert before_s >= 0.1
