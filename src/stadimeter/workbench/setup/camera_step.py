"""The first question: which camera, and a look through it, at a camera that stays open between looks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.config.driver_tables import CAMERA
from stadimeter.config.plugins import CAMERAS, DriverChoice, driver_names
from stadimeter.config.toml_source import camera_table
from stadimeter.core.frame import Frame
from stadimeter.errors import DriverError, PictureError, StadimeterError
from stadimeter.workbench import frame_source
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.measuring import is_video_file
from stadimeter.workbench.picture_metadata import picture_remarks
from stadimeter.workbench.setup.question import PICTURES, Accepted, Known, Option, Question, SetupStep, words_of

# The picture in which places are meant that answers name.
SHOWN = f"{PICTURES}/camera.png"

# How a run plays files until it ends: each picture long enough for a person to see the detection.
PLAYED: Mapping[str, Mapping[str, Any]] = {
    "images": {"rate": "5 Hz", "dwell": "2 s", "loop": True},
    "video": {"loop": True},
}

# The camera in the simulated room.
SIMULATED = "simulated"

# The number of pictures of a recording that are kept, spread over it.
MAX_FRAMES = 4

# Later frames of a recording are ignored.
MAX_RECORDED_FRAMES = 2000

_DRIVER = re.compile(r"[a-z][\w-]*")


class CameraStep(SetupStep):
    """A camera that is there, the address of a stream, a video, or picture files."""

    key = "camera"
    names_files = True

    def question(self, known: Known) -> Question:
        """List the cameras that are there, each with a picture of it."""
        cameras = frame_source.list_cameras()
        pictures = _pictures_in(known.folder)
        tried = [(each, _try(known, each, number)) for number, each in enumerate(cameras, start=1)]
        options = [Option(each.choice, f"{each.name}: {words}") for each, (words, _) in tried]
        options += [Option(pictures, "the pictures in this folder")] if pictures else []
        ready = options[0].answer if options else ""
        why_none = "No camera is found; `stadimeter cameras` says what to look at."
        if not pictures:
            why_none = f"{frame_source.NONE_FOUND[0].upper()}{frame_source.NONE_FOUND[1:]}."
        options.append(
            Option(SIMULATED, f"a simulated room with a ball of {frame_source.BALL}, to try it without a camera")
        )
        return Question(
            text="Which camera?",
            found=() if cameras else (why_none,),
            options=tuple(options),
            ready=ready,
            is_sure=[is_seen for _, (_, is_seen) in tried] == [True],
            form=(
                "a device such as /dev/video0, picamera2, the address of a stream, a video file, picture files, or "
                "a folder of pictures"
            ),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Take pictures with the camera."""
        choice = known.choose(CAMERA, ("camera",), table_of(text))
        known.frames, known.is_live = _frames(known, choice)
        known.camera = choice
        known.camera_model = None
        write_picture(known.path(SHOWN), known.frame.image)
        size = f"{known.frame.width_px} × {known.frame.height_px} pixels"
        seen = f"It sees {size}.{known.shown_in(SHOWN)}"
        remarks = tuple(f"{each[0].upper()}{each[1:]}." for each in picture_remarks(known.frame.image))
        return Accepted(answer=text, notes=(seen, *remarks), doubt=bool(remarks))


def table_of(text: str) -> dict[str, Any]:
    """Return the table ``[camera]`` for an answer: of a camera, or of files.

    Raises:
        ConfigError: A quotation mark is missing.
    """
    if _names_driver(text):
        return camera_table(text)
    files = words_of(text)
    if len(files) == 1 and is_video_file(Path(files[0])):
        return {"driver": "video", "path": files[0], **PLAYED["video"]}
    return {"driver": "images", "paths": files, **PLAYED["images"]}


def _names_driver(text: str) -> bool:
    """Check whether an answer is a device, an address or a driver with its options, rather than files."""
    driver, _, options = text.partition(",")
    if driver.isdecimal() or driver.startswith("/dev/") or "://" in driver or driver in driver_names(CAMERAS):
        return True
    return bool(_DRIVER.fullmatch(driver)) and "=" in options


def with_exposure(text: str, exposure: str) -> str:
    """Return the answer for a camera with its exposure locked at a time such as ``10 ms``, in place of its own."""
    kept = [part for part in text.split(",") if part.partition("=")[0] != "exposure"]
    return ",".join([*kept, f"exposure={exposure.strip().replace(',', '.')}"])


def _frames(known: Known, choice: DriverChoice) -> tuple[tuple[Frame, ...], bool]:
    """Return pictures of a camera, and whether it is live."""
    with known.opening(choice) as source:
        if source.is_live:
            return (source.capture.latest(frame_source.SETTLING_WAIT_S),), True
        frames = _spread_frames(source)
    if not frames:
        raise PictureError(f"the camera {choice.driver} gives no picture")
    return frames, False


def _spread_frames(source: frame_source.Source) -> tuple[Frame, ...]:
    """Return some frames of a recording at even distances, and hold no more than twice as many at any time."""
    kept: list[Frame] = []
    step = 1
    for number, frame in enumerate(islice(source.frames(lambda _: None), MAX_RECORDED_FRAMES)):
        if number % step == 0:
            kept.append(frame)
        if len(kept) == 2 * MAX_FRAMES:
            kept, step = kept[::2], 2 * step
    return tuple(kept)


def _try(known: Known, camera: AttachedCamera, number: int) -> tuple[str, bool]:
    """Take a picture with a camera that is there; say where it is or what is wrong, and whether there is one."""
    if camera.trouble or not known.looks_ahead:
        return camera.trouble or camera.node, False
    name = f"{PICTURES}/camera-{number}.png"
    try:
        frame = frame_source.take_frame(known.choose(CAMERA, ("camera",), camera_table(camera.choice)), known.opening)
    except StadimeterError as error:
        return str(error), False
    write_picture(known.path(name), frame.image, frame.optics)
    return f"its picture is {name}", True


def _pictures_in(folder: Path) -> str:
    """Return a pattern for the pictures of a folder; empty if it has none."""
    for suffix in ("jpg", "png"):
        if next(folder.glob(f"*.{suffix}"), None):
            return f"*.{suffix}"
    return ""


class HeldCamera:
    """Opens a camera when it is first looked through, and holds it until another one is wanted, or `close`.

    Args:
        build: Builds a camera; touches no hardware.
    """

    def __init__(self, build: Callable[[DriverChoice], frame_source.Source] = frame_source.open_source) -> None:
        self._build = build
        self._choice: DriverChoice | None = None
        self._source: frame_source.Source | None = None

    @property
    def room(self) -> frame_source.SimulatedRoom | None:
        """The room that is simulated before the camera; None before a real one, or none."""
        return self._source.room if self._source is not None else None

    @contextmanager
    def hold(self, choice: DriverChoice) -> Iterator[frame_source.Source]:
        """Give a camera that is open and has settled. A recording is read from its beginning, and not held.

        A camera that fails is let go: the next look opens it anew, or another way.

        Raises:
            DriverError: It cannot be opened, or no frame comes.
        """
        source = self._source if choice == self._choice else None
        try:
            if source is None:
                self.close()
                source = self._build(choice)
                source.settle()
                if source.is_live:
                    self._choice, self._source = choice, source
            yield source
        except DriverError:
            self.close()
            raise
        finally:
            if source is not None and self._source is not source:
                source.capture.close()

    def close(self) -> None:
        """Let the camera go; it is opened again for the next look."""
        source, self._source = self._source, None
        if source is not None:
            source.capture.close()
