"""The cameras on this computer, of every installed driver that can list them, and what becomes of one when opened."""

from __future__ import annotations

from contextlib import closing
from typing import Any

from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.config.guides import guide
from stadimeter.config.plugins import CAMERAS, DriverChoice, driver_names, load_plugin
from stadimeter.errors import DriverError, DriverUnavailableError, PictureError
from stadimeter.workbench.frame_source import Snapshot, snapshots

NONE_FOUND = (
    "no camera is found. Is its cable plugged in, and does `ls /dev/video*` list it? A ribbon camera of a Raspberry Pi"
    " needs `sudo apt install python3-picamera2` and an environment that sees the system's packages; a camera in the"
    f" network is read as a stream ({guide('cameras.md')}), which no list can show"
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


def choice_of(camera: AttachedCamera, like: DriverChoice | None = None) -> DriverChoice:
    """Return a camera with its driver's default settings, or those of another camera of the same driver."""
    plugin = load_plugin(CAMERAS, camera.driver)
    if like is not None and like.driver == camera.driver:
        options: Any = like.options.model_copy(update=dict(camera.options))
    else:
        options = plugin.options.model_validate(camera.options)
    return DriverChoice(name="camera", driver=camera.driver, plugin=plugin, options=options)


def first_picture(choice: DriverChoice) -> Snapshot | str:
    """Open a camera and take a picture; return that, or why there is none."""
    try:
        with closing(snapshots(choice)) as taken:
            for each in taken:
                return each
    except (DriverError, PictureError) as error:
        return str(error)
    return "it gives no picture"
