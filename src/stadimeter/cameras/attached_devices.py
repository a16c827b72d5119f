"""The Video4Linux cameras on this computer, each by the path that stays right."""

from __future__ import annotations

import errno
import fcntl
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.cameras.v4l2 import Ioctl, ask_node, is_in_use

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
