"""Devices behind cameras: a Video4Linux device as OpenCV shows it, and a server of JPEG pictures."""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stadimeter.core.frame import Image
from support.broker import free_port


def picture(number: int) -> Image:
    """Return a picture that differs from the others."""
    return np.random.default_rng(number).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def open_files(path: Path) -> int:
    """Return how often this process has a file open."""
    handles = (Path("/proc/self/fd") / name for name in os.listdir("/proc/self/fd"))  # noqa: PTH208 - names, not paths
    return sum(os.path.realpath(handle) == str(path.resolve()) for handle in handles)


def connections_to(port: int) -> int:
    """Return how many sockets of this computer are connected to a local port and held by a program."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return sum(int(row[2].rpartition(":")[2], 16) == port and row[9] != "0" for row in rows)


class NodeDevice:
    """A Video4Linux device; each `__call__` is a handle to it, as ``cv2.VideoCapture`` gives one."""

    def __init__(self) -> None:
        self.handles: set[NodeHandle] = set()
        self.fails = False
        self.number = 0

    def fail(self) -> None:
        """Give no more pictures that can be decoded."""
        self.fails = True

    def __call__(self, *_source: Any) -> NodeHandle:
        handle = NodeHandle(self)
        self.handles.add(handle)
        return handle


class NodeHandle:
    """An open device. One that fails throws an error of OpenCV's when a picture is decoded."""

    def __init__(self, device: NodeDevice) -> None:
        self._device = device

    def isOpened(self) -> bool:  # noqa: N802
        return self in self._device.handles

    def set(self, _prop: int, _value: float) -> bool:
        return True

    def get(self, _prop: int) -> float:
        return -1.0

    def grab(self) -> bool:
        time.sleep(0.001)  # a device has a pace; without one the test of a lost device would spin
        return True

    def retrieve(self) -> tuple[bool, Image]:
        if self._device.fails:
            raise cv2.error("(-215:Assertion failed) !buf.empty()")
        self._device.number += 1
        return True, picture(self._device.number)

    def release(self) -> None:
        self._device.handles.discard(self)


# Fifty pictures a second, more than network cameras have: tests need not wait for long.
STREAM_PERIOD_S = 0.02


class StreamServer:
    """Sends JPEG pictures of noise over HTTP, as network cameras do, until it is stopped.

    Args:
        port: Where it listens; None for one that nothing else takes while it is stopped.
    """

    def __init__(self, port: int | None = None) -> None:
        self._is_stopped = threading.Event()
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                with suppress(OSError):  # the camera hung up
                    owner.serve(self)

            def log_message(self, *args: object) -> None:
                """Say nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", port or free_port()), Handler)
        self._server.daemon_threads = False
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self._thread.start()

    @property
    def address(self) -> str:
        """The address of the stream."""
        return f"http://127.0.0.1:{self._server.server_port}/cam"

    @property
    def connections(self) -> int:
        """How many cameras are connected."""
        return connections_to(self._server.server_port)

    def serve(self, request: BaseHTTPRequestHandler) -> None:
        """Send pictures until the connection or the server ends."""
        request.send_response(200)
        request.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        request.end_headers()
        # By its own clock, as a camera: a picture that comes late on a busy computer is no slower pace.
        number, due_s = 0, time.monotonic() + STREAM_PERIOD_S
        while not self._is_stopped.wait(max(0.0, due_s - time.monotonic())):
            due_s += STREAM_PERIOD_S
            _, data = cv2.imencode(".jpg", picture(number))
            head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            request.wfile.write(head.encode() + data.tobytes() + b"\r\n")
            number += 1

    def stop(self) -> None:
        """Hang up, and answer no more. May be called again."""
        if not self._is_stopped.is_set():
            self._is_stopped.set()
            self._server.shutdown()
            self._server.server_close()
            self._thread.join()
