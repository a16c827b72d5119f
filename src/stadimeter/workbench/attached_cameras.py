"""The cameras on this computer, of every installed driver that can list them."""

from __future__ import annotations

from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.config.plugins import CAMERAS, driver_names, load_plugin
from stadimeter.errors import DriverUnavailableError

NONE_FOUND = (
    "no camera is found. Is its cable plugged in, and does `ls /dev/video*` list it? A ribbon camera of a Raspberry Pi"
    " needs `sudo apt install python3-picamera2` and an environment that sees the system's packages; a camera in the"
    " network is read as a stream (docs/cameras.md), which no list can show"
)
"""What to say where there are no cameras."""


def attached_cameras() -> tuple[AttachedCamera, ...]:
    """Return the cameras that are there, without taking a picture; one that is in use or not ours says so.

    A driver that lacks a library cannot be used, so it has no cameras.
    """
    found: list[AttachedCamera] = []
    for name in driver_names(CAMERAS):
        try:
            plugin = load_plugin(CAMERAS, name)
        except DriverUnavailableError:
            continue
        found.extend(plugin.attached())
    return tuple(found)
