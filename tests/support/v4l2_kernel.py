"""Video4Linux devices as the kernel shows them: a tree of ``/sys`` and ``/dev``, and what ioctl answers."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest
from msgspec import Struct, field

from stadimeter.cameras import opencv_device, v4l2
from stadimeter.cameras.v4l2 import attached_devices

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
