"""Frames of a camera at a desk, with its settings but without the rest of a run, and of a simulated room."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.capture import Capture, capture_for
from stadimeter.app.clock import MonotonicClock, SteppedClock
from stadimeter.app.control.client import HELLO_WAIT_S, ask, fetch, find
from stadimeter.cameras.protocol import AttachedCamera, Camera, ListsCameras
from stadimeter.config.driver_tables import WORLD
from stadimeter.config.extras import guide
from stadimeter.config.plugins import CAMERAS, DriverChoice, DriverContext, Shared, driver_names, load_driver
from stadimeter.config.units import parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Optics
from stadimeter.errors import (
    CaptureTimeoutError,
    ConfigError,
    ControlError,
    DriverError,
    DriverUnavailableError,
    EndOfFramesError,
    PictureError,
    ProtocolError,
)
from stadimeter.workbench.picture_metadata import picture_remarks

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import StagedWorld


# The diameter of the ball in the room.
BALL = "20 cm"

CAMERA_HEIGHT = "25 cm"

# Beyond this nothing is put: the ball would be a few pixels.
MAX_DISTANCE_M = 8.0

_LENS = CameraModel.with_focal_length(600.0, 640, 480)


class SimulatedRoom:
    """A room with a ball, and a camera in it whose pictures come at their own pace."""

    def __init__(self, camera: DriverChoice) -> None:
        clock, shared = MonotonicClock(), Shared()
        # At the height of the camera, so that a distance is one along the floor.
        options = load_driver(WORLD.group, WORLD.default).model_validate(
            {"ball_diameter": BALL, "ball_height": CAMERA_HEIGHT, "camera_height": CAMERA_HEIGHT}
        )
        context = DriverContext(name="world", clock=clock, camera_model=_LENS, shared=shared)
        self._world: StagedWorld = options.build(context)
        self._radius_m = parse_length(BALL) / 2
        self.capture = capture_for(camera.options.build(context), clock)
        self.place(1.0 + self._radius_m, 0.0)

    def place(self, x_m: float, y_m: float) -> None:
        """Put the middle of the ball so far ahead of the camera, and to its left; a `ConfigError` if it cannot be."""
        if not (math.hypot(x_m, y_m) <= MAX_DISTANCE_M and x_m > self._radius_m):
            raise ConfigError(
                f"the ball can be {self._radius_m:g} to {MAX_DISTANCE_M:g} m before the camera, "
                f"not at {x_m:g}, {y_m:g} m"
            )
        self._world.place_target(x_m, y_m)
        self._place_m = x_m, y_m

    def where(self) -> dict[str, float]:
        """Return where the ball was put: its middle, and how far away its nearest point is, as by a tape."""
        x_m, y_m = self._place_m
        return {"x_m": x_m, "y_m": y_m, "distance_m": math.hypot(x_m, y_m) - self._radius_m}


# A live camera sets its exposure in its first frames, unless that is fixed.
FRAME_WAIT_S = 0.5
SETTLING_FRAMES = 10

# Some cameras take seconds to give their first frame.
SETTLING_WAIT_S = 5.0


class Source(Struct, frozen=True, kw_only=True):
    """The source of the frames.

    Attributes:
        is_live: Whether they come at the camera's own pace; of a recording every frame counts.
        room: The room that is simulated before the camera; None before a real one.
    """

    capture: Capture
    is_live: bool
    room: SimulatedRoom | None = None

    def settle(self) -> None:
        """Open it, and pass over the first frames of a live camera.

        Raises:
            DriverError: It cannot be opened, or no frame comes.
        """
        self.capture.open()
        for _ in range(SETTLING_FRAMES if self.is_live else 0):
            self.capture.latest(SETTLING_WAIT_S)

    def frames(self, note: Callable[[str], None]) -> Iterator[Frame]:
        """Yield the frames of the open source until they end; of a live camera the newest, without an end.

        Args:
            note: Takes a sentence while none comes, each time that it changes.

        Raises:
            PictureError: A recording is damaged at this point.
        """
        said = ""
        while True:
            try:
                yield self.capture.latest(FRAME_WAIT_S)
                said = ""
            except CaptureTimeoutError as error:
                if str(error) != said:
                    said = str(error)
                    note(said)
            except EndOfFramesError:
                return


def open_source(choice: DriverChoice) -> Source:
    """Build a camera. Touches no hardware. A recording is looked through once, each of its pictures in one frame.

    Raises:
        DriverError: It cannot be built.
    """
    if choice.options.needs_world:
        room = SimulatedRoom(choice)
        return Source(capture=room.capture, is_live=True, room=room)
    choice = _once(choice)
    clock: SteppedClock | MonotonicClock = SteppedClock()
    camera: Camera = choice.options.build(DriverContext(name=choice.name, clock=clock))
    if camera.is_live:
        clock = MonotonicClock()
        camera = choice.options.build(DriverContext(name=choice.name, clock=clock))
    return Source(capture=capture_for(camera, clock), is_live=camera.is_live)


def _once(choice: DriverChoice) -> DriverChoice:
    """Return the choice without looping and dwelling, which serve the viewers of a run."""
    options = choice.options
    changes = {key: plain for key, plain in (("loop", False), ("dwell", 0.0)) if getattr(options, key, plain) != plain}
    return replace(choice, options=options.model_copy(update=changes)) if changes else choice


@contextmanager
def open_camera(choice: DriverChoice) -> Iterator[Source]:
    """Give a camera that is open and has settled; close it afterwards.

    Raises:
        DriverError: It cannot be opened, or no frame comes.
    """
    source = open_source(choice)
    try:
        source.settle()
        yield source
    finally:
        source.capture.close()


# Gives a camera that is open and has settled: `open_camera`, or something that keeps it open.
Opening = Callable[[DriverChoice], AbstractContextManager[Source]]


def take_frame(choice: DriverChoice, opening: Opening = open_camera) -> Frame:
    """Return one frame of a camera, as its settings make it: of a live one not the first ones.

    Raises:
        DriverError: It cannot be opened, or no frame comes.
    """
    with opening(choice) as source:
        return source.capture.latest(SETTLING_WAIT_S)


# A note for people who calibrate from pictures.
OTHER_PROGRAMS = (
    "a photograph by another program may have another focal length: take pictures for calibration in this way, with"
    " the camera's settings of the configuration"
)


class CameraShot(Struct, frozen=True, kw_only=True, eq=False):
    """A picture of a camera.

    Attributes:
        settings: Which settings the camera did not take, a sentence each.
        faults: What is wrong with the picture, a sentence each.
    """

    frame: Frame
    settings: tuple[str, ...]
    faults: tuple[str, ...]


def snapshots(choice: DriverChoice, *, apart_s: float = 0.0) -> Generator[CameraShot, None, None]:
    """Yield pictures of a camera without an end, or until a recording ends. Close the iterator to close the camera.

    Args:
        apart_s: How long to wait from one to the next, at least.

    Raises:
        DriverError: The camera cannot be opened, or no frame comes.
        PictureError: A recording cannot be read.
    """
    with open_camera(choice) as source:
        next_s = float("-inf")
        while True:
            try:
                frame = source.capture.latest(SETTLING_WAIT_S)
            except EndOfFramesError:
                return
            if frame.captured_at_s >= next_s:
                next_s = frame.captured_at_s + apart_s
                yield CameraShot(
                    frame=frame,
                    settings=source.capture.remarks(),
                    faults=picture_remarks(frame.image, frame.exposure_s),
                )


# The camera of a run, seen through the run: a device can be opened once only, and the run must not lose it ------------

# While the run has no newer picture, it is asked again this often.
ASK_EVERY_S = 0.02


class RunCamera(Capture):
    """Gets the frames of a run over its control socket."""

    def __init__(self, socket: Path) -> None:  # the camera is the run's
        self._socket = socket
        self._sequence = -1

    def open(self) -> None:
        """Do nothing: the run has opened the camera."""

    def latest(self, timeout_s: float) -> Frame:
        """Return the run's newest frame once it is another one than the last; see `Capture`."""
        until_s = time.monotonic() + timeout_s
        why = f"no new one for {timeout_s:g} s"
        while True:
            try:
                frame = _frame(*fetch(self._socket, "frame", {"encoding": "raw", "image": "plain"}))
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
        """Do nothing: the run goes on."""


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
    from stadimeter.config.loader import load_camera_choice  # noqa: PLC0415 - most of a start, and rarely needed

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
            return next(taken, "it gives no picture")
    except (DriverError, PictureError) as error:
        return str(error)
