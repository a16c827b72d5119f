"""Cameras where there are none: OpenCV's capture of one node, and Video4Linux devices as the kernel shows them."""

from __future__ import annotations

import errno
import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec import Struct, field

from stadimeter.cameras import opencv_device, v4l2
from stadimeter.cameras.v4l2 import attached_devices
from stadimeter.core.frame import Image

# A camera where there is none: OpenCV's capture of one Video4Linux node, answered by a picture that can be changed.

PACE_S = 0.005
"""Time between frames: a device has a pace, and the tests have little time."""

DELIVERED_S = 5.0


class V4l2Double:
    """A device that takes every setting that it is not told to keep, and shows one picture with fresh sensor noise.

    Put it in place of ``cv2.VideoCapture`` by `plugged_in`; other files and streams still reach OpenCV.

    Attributes:
        node: Its path; a file that is there for as long as the device is plugged in.
        kept: Properties that it does not let be changed, with what it says of them.
        set_to: Every property that was set, with its last value.
        is_busy: Whether another program has it.
    """

    def __init__(self, node: Path, image: Image) -> None:
        self.node = node
        self.kept: dict[int, float] = {}
        self.set_to: dict[int, float] = {}
        self.is_busy = False
        self._image = image
        self._rng = np.random.default_rng(1)
        self._open_capture = cv2.VideoCapture
        self._frames = threading.Condition()
        self._grabbed = 0
        self._is_open = False
        node.parent.mkdir(parents=True, exist_ok=True)
        node.touch()

    @classmethod
    def plugged_in(cls, node: Path, image: Image, monkeypatch: pytest.MonkeyPatch) -> V4l2Double:
        """Return a double that drivers reach at that path, until the test ends."""
        device = cls(node, image)
        monkeypatch.setattr(cv2, "VideoCapture", device)
        return device

    def __call__(self, source: Any, api: int = cv2.CAP_ANY, params: Any = ()) -> Any:
        if api != cv2.CAP_V4L2 or source != str(self.node):
            return self._open_capture(source, api, params)
        self._is_open = not self.is_busy
        return self

    def show(self, image: Image) -> None:
        """Show another picture; return when an open camera has delivered it twice."""
        with self._frames:
            self._image = image
            wanted = self._grabbed + 3  # the first may still be the old one
            assert not self._is_open or self._frames.wait_for(lambda: self._grabbed >= wanted, DELIVERED_S)

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return self._is_open

    def set(self, prop: int, value: float) -> bool:
        self.set_to[prop] = value
        return prop not in self.kept

    def get(self, prop: int) -> float:
        return self.kept.get(prop, self.set_to.get(prop, -1.0))

    def grab(self) -> bool:
        with self._frames:
            self._frames.wait(PACE_S)
            if not (self._is_open and self.node.exists()):
                return False
            self._grabbed += 1
            self._frames.notify_all()
            return True

    def retrieve(self) -> tuple[bool, Image]:
        noise = self._rng.integers(-2, 3, self._image.shape, np.int8)
        return True, np.clip(self._image.astype(np.int16) + noise, 0, 255).astype(np.uint8)

    def release(self) -> None:
        self._is_open = False


# Video4Linux devices as the kernel shows them: a tree of ``/sys`` and ``/dev``, and what ioctl answers.

CAPTURE, METADATA = 0x84200001, 0x84A00000


class Node(Struct):
    """What a node of the double answers: the kernel's lists, entry by entry."""

    capabilities: int = CAPTURE
    driver: str = "uvcvideo"
    card: str = "HD Webcam C615"
    formats: Sequence[str] = ("MJPG", "YUYV", "H264")
    sizes: Sequence[tuple[int, ...]] = ((1, 640, 480), (1, 1280, 720))
    intervals: Sequence[tuple[int, ...]] = ((1, 1, 30), (1, 1, 15), (1, 2, 15))
    in_use: bool = False


class Kernel(Struct):
    """A folder with the nodes of some cameras, and the ioctl that answers for them."""

    root: Path
    nodes: dict[str, Node] = field(default_factory=dict)

    def add(self, name: str, node: Node, *, index: int = 0, by_id: str = "", by_path: str = "") -> Path:
        self.nodes[name] = node
        system = self.root / "sys/class/video4linux" / name
        system.mkdir(parents=True)
        (system / "name").write_text(f"{node.card}\n")
        (system / "index").write_text(f"{index}\n")
        device = self.root / "dev" / name
        device.parent.mkdir(exist_ok=True)
        device.touch()
        for folder, link in (("by-id", by_id), ("by-path", by_path)):
            if link:
                (self.root / "dev/v4l" / folder).mkdir(parents=True, exist_ok=True)
                path = self.root / "dev/v4l" / folder / link
                path.unlink(missing_ok=True)
                path.symlink_to(Path("../..") / name)
        return device

    def __call__(self, descriptor: int, request: int, answer: bytearray) -> int:
        node = self.nodes[Path(f"/proc/self/fd/{descriptor}").readlink().name]
        if request == v4l2.QUERYCAP:
            words = node.driver.encode(), node.card.encode(), b"usb-0000:01:00.0-1.3"
            answer[:] = v4l2.CAPABILITY.pack(*words, 0x60100, 0x84A00001 | v4l2.THIS_NODE, node.capabilities, 0, 0, 0)
        elif request == v4l2.REQBUFS:
            if node.in_use:
                raise OSError(errno.EBUSY, "Device or resource busy")
        else:
            self._list(node, request, answer)
        return 0

    @staticmethod
    def _list(node: Node, request: int, answer: bytearray) -> None:
        entries, kind, at = {
            v4l2.ENUM_FMT: (node.formats, v4l2.FORMAT, 4),
            v4l2.ENUM_FRAMESIZES: (node.sizes, v4l2.FRAME_SIZE, 2),
            v4l2.ENUM_FRAMEINTERVALS: (node.intervals, v4l2.FRAME_INTERVAL, 4),
        }[request]
        fields = list(kind.unpack(answer))
        if fields[0] >= len(entries):
            raise OSError(errno.EINVAL, "Invalid argument")
        entry = entries[fields[0]]
        new = [int.from_bytes(entry.encode(), "little")] if isinstance(entry, str) else list(entry)
        fields[at : at + len(new)] = new
        answer[:] = kind.pack(*fields)

    def answers(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Have the driver of Video4Linux cameras ask this double instead of the kernel, until the test ends."""
        listed = partial(attached_devices, self.root, self)
        monkeypatch.setattr(opencv_device, "attached_devices", listed)
