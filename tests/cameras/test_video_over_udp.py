"""H.264 over UDP from a real sender that is stopped for a while."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator

import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from support.broker import free_port
from support.programs import needs

pytestmark = [pytest.mark.long, needs("ffmpeg")]

PICTURES = "testsrc=size=320x240:rate=30,noise=alls=6:allf=t"
CODEC = ["-c:v", "libx264", "-preset", "ultrafast", "-tune", "zerolatency", "-pix_fmt", "yuv420p", "-g", "15"]


@pytest.fixture
def address() -> str:
    return f"udp://127.0.0.1:{free_port()}"


@pytest.fixture
def sender(address: str) -> Iterator[subprocess.Popen[bytes]]:
    source = ["-re", "-f", "lavfi", "-i", PICTURES]
    output = ["-f", "mpegts", f"{address}?pkt_size=1316"]
    process = subprocess.Popen(["ffmpeg", "-v", "fatal", "-nostdin", *source, *CODEC, *output])
    yield process
    process.kill()
    process.wait()


@pytest.fixture
def camera(address: str, sender: subprocess.Popen[bytes]) -> Iterator[OpenCvCamera]:
    options = {"device": address, "latency": "100 ms", "read_timeout": "5 s"}
    camera = OpenCvCamera(OpenCvOptions.model_validate(options), MonotonicClock())
    camera.open()
    yield camera
    camera.close()


def ages_s(camera: OpenCvCamera, count: int) -> list[float]:
    clock = MonotonicClock()
    captured_s = (camera.read().captured_at_s for _ in range(count))
    return [-at_s + clock.now_s() for at_s in captured_s]


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
