"""The camera of a run, seen through the run: a device can be opened once only, and the run must not lose it."""

from __future__ import annotations

import os
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from stadimeter.app.capture import Capture
from stadimeter.app.control.client import HELLO_WAIT_S, ask, fetch, find
from stadimeter.cameras.protocol import AttachedCamera, ListsCameras
from stadimeter.config.extras import guide
from stadimeter.config.loader import load_camera_choice
from stadimeter.config.plugins import CAMERAS, DriverChoice, driver_names, load_driver
from stadimeter.core.frame import Frame, Optics
from stadimeter.errors import (
    CaptureTimeoutError,
    ConfigError,
    ControlError,
    DeviceClosedError,
    DriverError,
    DriverUnavailableError,
    PictureError,
    ProtocolError,
)
from stadimeter.workbench.frame_source import CameraShot, Source, open_source, snapshots

# While the run has no newer picture, it is asked again this often.
ASK_EVERY_S = 0.02


class RunCamera(Capture):
    """Gets the frames of a run over its control socket."""

    def __init__(self, socket: Path) -> None:  # the camera is the run's
        self._socket = socket
        self._is_open = False
        self._sequence = -1

    def open(self) -> None:
        """Make ready; the run has opened the camera."""
        self._is_open = True

    def latest(self, timeout_s: float) -> Frame:
        """Return the run's newest frame once it is another one than the last; see `Capture`."""
        until_s = time.monotonic() + timeout_s
        why = f"no new one for {timeout_s:g} s"
        while True:
            try:
                frame = self._newest()
            except ControlError as error:
                why = str(error)
            else:
                if frame.sequence != self._sequence:
                    self._sequence = frame.sequence
                    return frame
            if time.monotonic() >= until_s or not self._socket.exists():
                raise CaptureTimeoutError(f"the run that has this camera gives no picture: {why}")
            time.sleep(ASK_EVERY_S)

    def remarks(self) -> tuple[str, ...]:
        """Say whose camera it is."""
        return ("a run has this camera open, with the settings of its configuration; its pictures are used",)

    def not_for_motion(self) -> str:
        """Return an empty string: nothing here moves."""
        return ""

    def close(self) -> None:
        """Ask the run no more."""
        self._is_open = False

    def _newest(self) -> Frame:
        if not self._is_open:
            raise DeviceClosedError("the camera is not open; open it before asking for frames")
        return _frame(*fetch(self._socket, "frame", {"encoding": "raw", "image": "plain"}))


def _frame(data: Any, pixels: bytes) -> Frame:
    try:
        image = np.frombuffer(pixels, np.uint8).reshape(data["height_px"], data["width_px"], 3)
        written: dict[str, Any] = data["optics"] or {}
        optics: dict[str, Any] = {key: tuple(each) if isinstance(each, list) else each for key, each in written.items()}
        return Frame(
            image,
            data["captured_at_s"],
            data["sequence"],
            subsampling=data["subsampling"],
            optics=Optics(**optics) if optics else None,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ProtocolError(f"the run's picture makes no sense: {error}") from error


def source_beside_run(choice: DriverChoice, configuration: Path, socket: Path | None) -> Source:
    """Build a camera; through the run of a configuration if that has the same one.

    Args:
        socket: Where the run listens; None to look for it.

    Raises:
        DriverError: It cannot be built.
    """
    try:
        place = socket or find(configuration)
        ask(place, "hello", wait_s=HELLO_WAIT_S)
        theirs = load_camera_choice(configuration)
    except (ControlError, ConfigError):
        return open_source(choice)
    if not is_same_camera(choice, theirs):
        return open_source(choice)
    return Source(capture=RunCamera(place), is_live=True)


def is_same_camera(one: DriverChoice, other: DriverChoice) -> bool:
    """Check whether two tables mean one device. Files are none: any number of programs may read them."""
    if one.driver != other.driver or one.driver in {"images", "video"}:
        return False
    if one.driver == "opencv":
        return _device(one) == _device(other)
    return getattr(one.options, "camera", None) == getattr(other.options, "camera", None)


def _device(choice: DriverChoice) -> str:
    written = getattr(choice.options, "device", None)
    path = f"/dev/video{written}" if isinstance(written, int) else str(written)
    return path if "://" in path else os.path.realpath(path)


# The message where there are no cameras.
NONE_FOUND = (
    "no camera is found. Is its cable plugged in, and does `ls /dev/video*` list it? A ribbon camera of a Raspberry Pi"
    " needs `sudo apt install python3-picamera2` and an environment that sees the system's packages; a camera in the"
    f" network is read as a stream ({guide('cameras.md')}), which no list can show"
)


def list_cameras() -> tuple[AttachedCamera, ...]:
    """Return the cameras that are there, without taking a picture; one that is in use or not ours says so.

    A driver that lacks a library cannot be used, so it has no cameras.
    """
    found: list[AttachedCamera] = []
    for name in driver_names(CAMERAS):
        try:
            driver = load_driver(CAMERAS, name)
        except DriverUnavailableError:
            continue
        if issubclass(driver, ListsCameras):
            found.extend(driver.attached())
    return tuple(found)


def choice_of(camera: AttachedCamera, like: DriverChoice | None = None) -> DriverChoice:
    """Return a camera with its driver's default settings, or those of another camera of the same driver."""
    if like is not None and like.driver == camera.driver:
        options = like.options.model_copy(update=dict(camera.options))
    else:
        options = load_driver(CAMERAS, camera.driver).model_validate(camera.options)
    return DriverChoice(name="camera", driver=camera.driver, options=options)


def first_picture(choice: DriverChoice) -> CameraShot | str:
    """Open a camera and take a picture; return that, or why there is none."""
    try:
        with closing(snapshots(choice)) as taken:
            for each in taken:
                return each
    except (DriverError, PictureError) as error:
        return str(error)
    return "it gives no picture"
