"""A real sender that is stopped, hangs, and comes back, seen through the whole live chain."""

from __future__ import annotations

import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.app.capture import LiveCapture
from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, DeviceOpenError
from support.programs import needs

pytestmark = needs("ffmpeg")

PATIENCE_S = 120.0


class Sender:
    """Plays a video for ever as an HTTP stream of JPEG pictures, to one receiver."""

    def __init__(self, video: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"http://127.0.0.1:{free.getsockname()[1]}/cam"
        self._video = video
        self._process: subprocess.Popen[bytes] | None = None
        self._starts = 0

    def start(self) -> None:
        """Play the video from its first picture: in another quality each time, or its pictures would be old ones."""
        self._starts += 1
        quality = str(4 + self._starts)
        source = ["-re", "-stream_loop", "-1", "-i", str(self._video)]
        output = ["-c:v", "mjpeg", "-q:v", quality, "-f", "mpjpeg", "-listen", "1", self.address]
        self._process = subprocess.Popen(["ffmpeg", "-v", "fatal", "-nostdin", *source, *output])

    def start_if_ended(self) -> None:
        """Start again if a busy computer cut the connection: FFmpeg serves one, and ends with it."""
        if self._process is not None and self._process.poll() is not None:
            self.start()

    def hang(self) -> None:
        assert self._process
        self._process.send_signal(signal.SIGSTOP)

    def stop(self) -> None:
        if self._process:
            self._process.kill()
            self._process.wait()
            self._process = None


@pytest.fixture
def video(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return the ball video, or a generated one where there is none."""
    try:
        pictures: Path = request.getfixturevalue("real_pictures")
        return pictures / "ball_video" / "green_ball.mp4"
    except pytest.skip.Exception:
        return write_moving_disc(tmp_path / "disc.avi")


def write_moving_disc(path: Path) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 24.0, (640, 480))
    for number in range(48):
        image = np.full((480, 640, 3), 200, np.uint8)
        cv2.circle(image, (80 + 10 * number, 240), 40, (0, 160, 0), -1)
        writer.write(image)
    writer.release()
    return path


@pytest.fixture
def sender(video: Path) -> Iterator[Sender]:
    sender = Sender(video)
    yield sender
    sender.stop()


@pytest.fixture
def capture(sender: Sender) -> Iterator[LiveCapture]:
    """Return an open capture of the running stream."""
    sender.start()
    clock = MonotonicClock()
    options = OpenCvOptions.model_validate({"device": sender.address, "read_timeout": "500 ms"})
    capture = LiveCapture(OpenCvCamera(options, clock), clock)
    open_when_sent(capture)
    yield capture
    capture.close()


def open_when_sent(capture: LiveCapture) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            capture.open()
        except DeviceOpenError:
            assert time.monotonic() < deadline_s, "the sender did not come up"
            time.sleep(0.02)
        else:
            return


def words_when_frames_end(capture: LiveCapture) -> str:
    """Take frames until none comes and the camera is given up, and return what the capture says then."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        try:
            capture.latest(0.4)
        except CaptureTimeoutError as error:
            if "opening the camera again" in str(error):
                return str(error)
    return pytest.fail(f"the end of the frames was not noticed: {capture.trouble()!r}")


def frame_when_they_come_again(capture: LiveCapture, sender: Sender) -> Frame:
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return capture.latest(0.2)
        except CaptureTimeoutError:
            assert time.monotonic() < deadline_s, f"no frames came again: {capture.trouble()}"
            sender.start_if_ended()


@pytest.mark.long
def test_frames_come_one_after_the_other_at_the_sender_s_pace(capture: LiveCapture) -> None:
    frames = [capture.latest(PATIENCE_S) for _ in range(5)]
    assert all(frame.image.shape == (480, 640, 3) for frame in frames)
    assert frames[-1].captured_at_s - frames[0].captured_at_s < 5.0
    assert len({frame.image.tobytes() for frame in frames}) == 5
    assert capture.trouble() == ""


@pytest.mark.long
def test_a_sender_that_is_stopped_is_told_and_frames_come_again_when_it_is_back(
    sender: Sender, capture: LiveCapture
) -> None:
    before = capture.latest(PATIENCE_S)
    sender.stop()
    assert sender.address in words_when_frames_end(capture)
    sender.start()
    after = frame_when_they_come_again(capture, sender)
    assert after.sequence > before.sequence
    assert after.captured_at_s > before.captured_at_s
    assert capture.trouble() == ""


@pytest.mark.long
def test_a_sender_that_hangs_is_told_and_frames_come_again_when_it_is_replaced(
    sender: Sender, capture: LiveCapture
) -> None:
    capture.latest(PATIENCE_S)
    sender.hang()
    assert sender.address in words_when_frames_end(capture)
    sender.stop()
    sender.start()
    assert frame_when_they_come_again(capture, sender).image.shape == (480, 640, 3)


@pytest.mark.long
def test_closing_while_the_sender_hangs_ends_the_thread(sender: Sender, capture: LiveCapture) -> None:
    capture.latest(PATIENCE_S)
    sender.hang()
    capture.close()
    assert capture.trouble() == "the camera is not open"
