"""The camera contract over every camera. A new camera gets a class here with a ``camera`` fixture."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras.image_files import ImageFilesCamera
from stadimeter.cameras.opencv_device import OpenCvCamera
from stadimeter.cameras.opencv_settings import OpenCvOptions
from stadimeter.cameras.protocol import Camera
from stadimeter.cameras.video_file import VideoFileCamera
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image
from stadimeter.testing.camera_contract import FRAMES, CameraContract


def picture(number: int) -> Image:
    """Return a picture that differs from the others."""
    return np.random.default_rng(number).integers(0, 256, (48, 64, 3), dtype=np.uint8)


class TestImageFiles(CameraContract):
    @pytest.fixture
    def camera(self, clock: Clock, tmp_path: Path) -> Iterator[Camera]:
        for number in range(FRAMES):
            cv2.imwrite(str(tmp_path / f"{number}.png"), picture(number))
        camera = ImageFilesCamera((str(tmp_path),), 5.0, clock)
        yield camera
        camera.close()

    @pytest.fixture
    def absent_camera(self, clock: Clock, tmp_path: Path) -> Camera:
        return ImageFilesCamera((str(tmp_path / "absent.png"),), 5.0, clock)


class TestVideoFile(CameraContract):
    @pytest.fixture(params=["clip.avi", "clip.mp4"])
    def camera(self, clock: Clock, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Camera]:
        path = tmp_path / request.param
        codec = {".avi": "MJPG", ".mp4": "mp4v"}[path.suffix]
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 25.0, (64, 48))
        for number in range(FRAMES):
            writer.write(picture(number))
        writer.release()
        camera = VideoFileCamera(path, None, clock)
        yield camera
        camera.close()

    @pytest.fixture
    def absent_camera(self, clock: Clock, tmp_path: Path) -> Camera:
        return VideoFileCamera(tmp_path / "absent.mp4", None, clock)


class StreamHandler(BaseHTTPRequestHandler):
    """Sends JPEG pictures for ever, as network cameras do."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        number = 0
        while True:
            _, data = cv2.imencode(".jpg", picture(number))
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            try:
                self.wfile.write(head.encode() + data.tobytes() + b"\r\n")
            except OSError:  # the camera hung up
                return
            number += 1
            time.sleep(0.01)

    def log_message(self, *args: object) -> None:
        """Say nothing."""


class TestOpenCvStream(CameraContract):
    @pytest.fixture
    def clock(self) -> Clock:
        return MonotonicClock()

    @pytest.fixture
    def address(self) -> Iterator[str]:
        """Return the address of a running stream."""
        server = ThreadingHTTPServer(("127.0.0.1", 0), StreamHandler)
        server.daemon_threads = False
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/cam"
        server.shutdown()
        server.server_close()
        thread.join()

    @pytest.fixture
    def camera(self, clock: Clock, address: str) -> Iterator[Camera]:
        camera = OpenCvCamera(OpenCvOptions(device=address), clock)
        yield camera
        camera.close()

    @pytest.fixture
    def absent_camera(self, clock: Clock) -> Iterator[Camera]:
        with socket.socket() as bound_but_silent:
            bound_but_silent.bind(("127.0.0.1", 0))
            port = bound_but_silent.getsockname()[1]
            yield OpenCvCamera(OpenCvOptions(device=f"http://127.0.0.1:{port}/cam"), clock)
