"""The Video4Linux cameras on this computer, each by the path that stays right, and what their nodes say of themselves.

OpenCV sets a device up but cannot list what it has. The kernel answers by ioctl; the requests and structures below are
those of ``linux/videodev2.h``, which are the same on every Linux of 32 or 64 bits and never change.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.cameras.protocol import AttachedCamera, CameraMode

QUERYCAP = 0x80685600
ENUM_FMT = 0xC0405602
ENUM_FRAMESIZES = 0xC02C564A
ENUM_FRAMEINTERVALS = 0xC034564B
REQBUFS = 0xC0145608

# ``v4l2_capability``: driver, card, bus, version, capabilities of the device and of this node, reserved.
CAPABILITY = struct.Struct("=16s32s32s6I")

# ``v4l2_fmtdesc``: index, type, flags, description, pixel format, bus code, reserved.
FORMAT = struct.Struct("=3I32s5I")

# ``v4l2_frmsizeenum``: index, pixel format, type, then width and height or their ranges, reserved.
FRAME_SIZE = struct.Struct("=3I6I2I")

# ``v4l2_frmivalenum``: index, pixel format, width, height, type, then a fraction of a second or a range, reserved.
FRAME_INTERVAL = struct.Struct("=5I6I2I")

# ``v4l2_requestbuffers``: count, type, memory, capabilities, flags.
BUFFERS = struct.Struct("=5I")

# The capabilities of this node are stated beside those of the whole device.
CAPTURES = 0x00000001
THIS_NODE = 0x80000000

# The node is a part of a pipeline that another program has to set up, as a Pi's ribbon camera is by libcamera.
NEEDS_MEDIA_CONTROLLER = 0x20000000
VIDEO_CAPTURE, MMAP, DISCRETE = 1, 1, 1

# Drivers whose nodes convert pictures of others, though they look like cameras.
NO_CAMERAS = frozenset({"bcm2835-isp"})

# Pixel formats that OpenCV turns into pictures (its cap_v4l.cpp).
READABLE = frozenset(
    {"MJPG", "JPEG", "YUYV", "UYVY", "YU12", "YV12", "NV12", "NV21", "411P", "BGR3", "RGB3", "XR24", "AR24"}
    | {"GREY", "Y16", "Y10", "Y12", "BA81", "GBRG", "GRBG", "RGGB"}
)

# Which sizes to name of a device that scales to any.
USUAL_SIZES = ((640, 480), (1280, 720), (1920, 1080))

# Nothing is asked for more often, lest a broken driver never ends its list.
MAX_ANSWERS = 256


# Asks the kernel: ``fcntl.ioctl``. Takes a node, a request and the answer to fill in; `OSError` where there is none.
Ioctl = Callable[[int, int, bytearray], int]


class NodeAnswer(Struct, frozen=True, kw_only=True):
    """The answer of a node about itself.

    Attributes:
        gives_pictures: Whether it is a camera that OpenCV can read, not one of its other nodes, such as for metadata.
    """

    name: str
    gives_pictures: bool
    modes: tuple[CameraMode, ...] = ()


def ask_node(path: Path, ioctl: Ioctl = fcntl.ioctl) -> NodeAnswer:
    """Ask a node about itself. It may be in use meanwhile.

    Raises:
        OSError: It is absent, this user may not open it, or it is no Video4Linux node.
    """
    with _opened(path) as node:
        driver, card, _, _, device, this_node, *_ = CAPABILITY.unpack(
            _answer(ioctl, node, QUERYCAP, bytearray(CAPABILITY.size))
        )
        flags = this_node if device & THIS_NODE else device
        captures = flags & CAPTURES and not flags & NEEDS_MEDIA_CONTROLLER and _text(driver) not in NO_CAMERAS
        modes = tuple(_modes(ioctl, node)) if captures else ()
        return NodeAnswer(name=_text(card), gives_pictures=bool(modes), modes=modes)


def is_in_use(path: Path, ioctl: Ioctl = fcntl.ioctl) -> bool:
    """Check whether another program takes pictures with a node, as far as the system shows it.

    To give back no buffers changes nothing, but the kernel allows it only to the program that took the device.
    """
    request = bytearray(BUFFERS.pack(0, VIDEO_CAPTURE, MMAP, 0, 0))
    try:
        with _opened(path) as node:
            ioctl(node, REQBUFS, request)
    except OSError as error:
        return error.errno == errno.EBUSY
    return False


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    node = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        yield node
    finally:
        os.close(node)


def _answer(ioctl: Ioctl, node: int, request: int, asked: bytearray) -> bytes:
    ioctl(node, request, asked)
    return bytes(asked)


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("utf-8", "replace").strip()


def _answers(ioctl: Ioctl, node: int, request: int, kind: struct.Struct, *given: int) -> Iterator[tuple[int, ...]]:
    """Yield the entries of one of the kernel's lists: it is asked by index until it says that there are no more."""
    for index in range(MAX_ANSWERS):
        asked = bytearray(kind.size)
        struct.pack_into(f"={1 + len(given)}I", asked, 0, index, *given)
        try:
            yield kind.unpack(_answer(ioctl, node, request, asked))
        except OSError:
            return


def _modes(ioctl: Ioctl, node: int) -> Iterator[CameraMode]:
    for entry in _answers(ioctl, node, ENUM_FMT, FORMAT, VIDEO_CAPTURE):
        code = entry[4]
        fourcc = code.to_bytes(4, "little").decode("latin-1")
        if fourcc.strip() not in READABLE:
            continue
        for width_px, height_px in _sizes(ioctl, node, code):
            rates_hz = tuple(sorted(set(_rates_hz(ioctl, node, code, width_px, height_px)), reverse=True))
            yield CameraMode(fourcc=fourcc, width_px=width_px, height_px=height_px, rates_hz=rates_hz)


def _sizes(ioctl: Ioctl, node: int, code: int) -> Iterator[tuple[int, int]]:
    for _, _, kind, *numbers in _answers(ioctl, node, ENUM_FRAMESIZES, FRAME_SIZE, code):
        if kind == DISCRETE:
            yield numbers[0], numbers[1]
            continue
        least_w, most_w, _, least_h, most_h, _ = numbers[:6]  # any size in steps; it is the only entry
        yield from (
            (width, height)
            for width, height in sorted({*USUAL_SIZES, (most_w, most_h)})
            if least_w <= width <= most_w and least_h <= height <= most_h
        )
        return


def _rates_hz(ioctl: Ioctl, node: int, code: int, width_px: int, height_px: int) -> Iterator[float]:
    given = (code, width_px, height_px)
    for *_, kind, above, below, _, _, _, _, _, _ in _answers(ioctl, node, ENUM_FRAMEINTERVALS, FRAME_INTERVAL, *given):
        if above:
            yield round(below / above, 3)  # the time between frames is above/below; of a range the shortest comes first
        if kind != DISCRETE:
            return


NOT_OURS = (
    "this user may not use it; add this user to the group 'video' (`sudo usermod -aG video $USER`), then log in anew"
)
NAMED_MAX = 3
_NOT_THERE = "the kernel knows it, but {node} is missing; a container has to be given it (--device {node})"


def in_use(*devices: str, proc: Path = Path("/proc")) -> str:
    """Return that a device is in use, in a sentence, with the programs that have it open as far as this user may see.

    Args:
        devices: Paths of nodes, or patterns such as ``/dev/media*``.
        proc: Where ``/proc`` is found; another one is for tests.
    """
    holders = sorted(
        f"{_read(process / 'comm')} (process {process.name})"
        for process in proc.glob("[0-9]*")
        if process.name != str(os.getpid()) and _has_open(process, devices)
    )
    if not holders:
        return f"another program is using it; close that one (`sudo fuser -v {' '.join(devices)}` names it)"
    more = ", …" if len(holders) > NAMED_MAX else ""
    return f"another program is using it: {', '.join(holders[:NAMED_MAX])}{more}; close that one"


def _has_open(process: Path, devices: tuple[str, ...]) -> bool:
    try:
        files = [str(file.readlink()) for file in (process / "fd").iterdir()]
    except OSError:  # it is another user's, or has ended
        return False
    return any(fnmatchcase(file, device) for file in files for device in devices)


def attached_devices(root: Path = Path("/"), ioctl: Ioctl = fcntl.ioctl) -> tuple[AttachedCamera, ...]:
    """Return every camera that OpenCV can read, by the number of its node.

    Most cameras have further nodes, such as for metadata; those are left out.

    Args:
        root: Where ``/sys`` and ``/dev`` are found; another one is for tests.
        ioctl: Asks the kernel; another one is for tests.
    """
    by_id, by_path = _links(root / "dev/v4l/by-id"), _links(root / "dev/v4l/by-path")
    nodes = sorted((root / "sys/class/video4linux").glob("video*"), key=_number)
    found = [camera for node in nodes if (camera := _camera(node, root / "dev" / node.name, ioctl))]
    # Cameras of one make without serial numbers share one name below by-id. It means the one that was found last, so
    # it stays right for none of them; the socket that each is plugged into does.
    nameless = {camera.name for camera in found if Path(camera.node).name not in by_id}
    return tuple(_named(camera, by_path if camera.name in nameless else by_id) for camera in found)


def _number(node: Path) -> int:
    return int(re.sub(r"\D", "", node.name) or 0)


def _links(folder: Path) -> Mapping[str, str]:
    """Return the first link to each node, by the node's name: the path that udev gives a device by what it is."""
    links = sorted(folder.glob("*"), reverse=True)
    return {link.resolve().name: str(link) for link in links}


def _camera(system: Path, node: Path, ioctl: Ioctl) -> AttachedCamera | None:
    name = _read(system / "name") or node.name
    plain = AttachedCamera(driver="opencv", options={}, path=str(node), name=name, node=str(node))
    try:
        answer = ask_node(node, ioctl)
    except OSError as error:
        return replace(plain, trouble=_trouble(error, node)) if _is_likely_camera(system) else None
    if not answer.gives_pictures:
        return None
    trouble = in_use(str(node)) if is_in_use(node, ioctl) else ""
    return replace(plain, name=answer.name or name, modes=answer.modes, trouble=trouble)


def _is_likely_camera(system: Path) -> bool:
    """Guess what a node is that cannot be asked: mostly the first node of a USB device is a camera, no other is."""
    bus = (system / "device/subsystem").resolve().name
    return _read(system / "index") in {"0", ""} and bus in {"usb", "subsystem"}  # the latter where there is no link


def _read(file: Path) -> str:
    try:
        return file.read_text("utf-8", "replace").strip()
    except OSError:
        return ""


def _trouble(error: OSError, node: Path) -> str:
    if error.errno in {errno.EACCES, errno.EPERM}:
        return NOT_OURS
    if error.errno in {errno.ENOENT, errno.ENXIO, errno.ENODEV}:
        return _NOT_THERE.format(node=node)
    if error.errno == errno.EBUSY:
        return in_use(str(node))
    return f"it does not answer: {error.strerror}"


def _named(camera: AttachedCamera, links: Mapping[str, str]) -> AttachedCamera:
    path = links.get(Path(camera.node).name, camera.node)
    return replace(camera, path=path, options={"device": path, "device_file": None})
