"""Pictures from files: one, or a camera that shows them one after the other, at the times that a recording says."""

from __future__ import annotations

import glob
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import islice, repeat
from pathlib import Path
from typing import Annotated

from msgspec import Struct
from pydantic import BeforeValidator, Field

from stadimeter.config import files
from stadimeter.config.camera_file import optics_in
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Duration, FilePath, Frequency
from stadimeter.core.camera_model import check_one_aspect
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame, Image, Optics, Subsampling
from stadimeter.errors import CalibrationError, DeviceClosedError, EndOfFramesError, PictureError, UnreadableError

# Reading one picture from a file --------------------------------------------------------------------------------------

# Endings of the names of pictures in a folder, in lower case.
PICTURE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})

_JPEG_START = b"\xff\xd8"
_OF_JPEG: dict[str, Subsampling] = {"444": "4:4:4", "Gray": "4:4:4", "422": "4:2:2"}


class Picture(Struct, frozen=True, kw_only=True, eq=False):
    """A picture file."""

    image: Image  # 8 bits a channel, blue first, shape ``(height, width, 3)``
    subsampling: Subsampling  # how coarsely the file stores colour
    optics: Optics | None = None  # how the camera was set, if the file says it


def load_picture(path: Path | str) -> Picture:
    """Read a picture as 8 bits a channel, blue first, shape ``(height, width, 3)``.

    Grey pictures get three equal channels, of more bits the upper 8 in use are kept, and transparency is dropped: each
    pixel keeps the colour that is stored for it. A picture whose EXIF data say that the camera was turned is turned
    upright.

    A JPEG or PNG that was cut short is refused, and a JPEG that is damaged inside. OpenCV would fill the missing part,
    and a target at the edge of that part would be measured.

    Raises:
        PictureError: The file is missing, empty, cut short, not a picture, or larger than is read; the message names it
            and the cause.
    """
    path = Path(path)
    file = _bytes_of(path)
    try:
        image = files.decode_picture(file)
    except PictureError as error:
        raise PictureError(f"the picture {path} {error}") from error
    return Picture(image=image, subsampling=subsampling_of(file), optics=optics_in(file))


def check_file(path: Path, kind: str) -> bytes:
    """Return the first bytes of a regular file, enough for `is_picture`; `kind` names it in the message.

    Raises:
        PictureError: It is missing, a folder, a device or empty, or may not be looked at.
    """
    try:
        with files.open_untrusted(path) as file:
            head = file.read(files.HEAD_BYTES)
    except UnreadableError as error:
        raise PictureError(f"the {kind} {path} cannot be read: {error.reason}") from error
    if not head:
        raise PictureError(f"the {kind} {path} is empty: the file has no bytes")
    return head


def _bytes_of(path: Path) -> bytes:
    # The beginning is looked at before the file is loaded: a video may be named by mistake.
    head = check_file(path, "picture")
    if files.is_video(head):
        raise PictureError(
            f"this is a video: {path}; `stadimeter measure` takes videos, and `stadimeter snapshot --live"
            f" video,path={path} --count 10 -o FILE.png` takes pictures out of one"
        )
    what = files.other_kind(head)
    if what or not files.is_picture(head):
        remedy = f"; {what}" if what else ""
        raise PictureError(f"{path} is not a picture of a kind that is read: {files.KINDS}{remedy}")
    try:
        return files.read_untrusted(path, files.PICTURE_MAX_BYTES)
    except UnreadableError as error:
        raise PictureError(f"the picture {path} cannot be read: {error.reason}") from error


def subsampling_of(data: bytes) -> Subsampling:
    """Find how coarsely a picture file stores colour, from its first bytes up to its pixels.

    Lossy WebP is always 4:2:0. All kinds but that and JPEG store every pixel.
    """
    if data.startswith(_JPEG_START):
        import simplejpeg  # noqa: PLC0415 - most commands read no JPEG

        with suppress(ValueError):
            return _OF_JPEG.get(simplejpeg.decode_jpeg_header(data)[3], "4:2:0")
    return "4:2:0" if data.startswith(b"RIFF") and data[12:16] == b"VP8 " else "4:4:4"


# Base of cameras that play a recording: time passes as the recording says ---------------------------------------------


class RecordedCamera(ABC):
    """A camera that plays a recording, at a steady rate unless it knows the time of each frame.

    The recording starts when the first frame is read: frame ``i`` was captured at ``start + i / rate``. Opening the
    camera again plays it from the beginning, at later times and with sequence numbers that go on.

    Args:
        what: The recording in a word or two, for error messages.
        loops: Whether it begins again after its last frame, while time goes on.
    """

    is_live = False  # every frame of a recording counts
    remarks: tuple[str, ...] = ()  # there is no device that could refuse a setting
    not_for_motion = ""  # the capture times are those of the recording

    def __init__(self, what: str, clock: Clock, *, loops: bool = False) -> None:
        self._what = what
        self._clock = clock
        self._loops = loops
        self._has_frames = False
        self._rate_hz: float | None = None
        self._started_at_s: float | None = None
        self._index = 0
        self._played_s: float | None = None
        self._delivered = 0
        self._subsampling: Subsampling = "4:4:4"
        self._optics: Optics | None = None

    def open(self) -> None:
        """Find the recording and go to its beginning.

        Raises:
            PictureError: It cannot be read.
        """
        self.close()
        self._played_s = None
        self._rate_hz = self._begin()
        self._started_at_s = None
        self._index = 0
        self._has_frames = False

    def read(self) -> Frame:
        """Wait until the next frame is due and return it.

        A frame that cannot be read raises once and is then passed over: the next call returns the one after it.

        Raises:
            DeviceClosedError: The camera is not open.
            EndOfFramesError: There are no more frames.
            PictureError: The recording is damaged at this point.
        """
        if self._rate_hz is None:
            raise DeviceClosedError(f"{self._what}: the camera is not open; open it before reading from it")
        if self._started_at_s is None:
            self._started_at_s = self._clock.now_s()
        steady_s = self._index / self._rate_hz
        self._index += 1
        image, source = self._next_or_first()
        self._has_frames = True
        captured_at_s = self._started_at_s + (steady_s if self._played_s is None else self._played_s)
        self._clock.sleep_until_s(captured_at_s)
        self._delivered += 1
        return Frame(image, captured_at_s, self._delivered - 1, source, self._subsampling, self._optics)

    def _next_or_first(self) -> tuple[Image, str]:
        try:
            return self._next()
        except EndOfFramesError:
            if not (self._loops and self._has_frames):  # one without a whole frame would be read for ever
                raise
        self._has_frames = False
        self._end()
        self._begin()
        return self._next()

    def close(self) -> None:
        """Let go of the recording."""
        self._rate_hz = None
        self._end()

    @abstractmethod
    def _begin(self) -> float:
        """Open the recording and return its frame rate in hertz."""

    @abstractmethod
    def _next(self) -> tuple[Image, str]:
        """Return the next picture and where it came from; note in ``_played_s`` when it comes, if that is known."""

    @abstractmethod
    def _end(self) -> None:
        """Close the recording, if it is open."""


# A camera that shows picture files, one after the other ---------------------------------------------------------------

# Pictures that `check` opens to compare their sizes: some seconds at most.
CHECKED_MAX = 100


def _one_or_many(value: object) -> object:
    return [value] if isinstance(value, str) else value


class ImageFilesOptions(DriverOptions):
    """The options of picture files as a camera."""

    paths: Annotated[tuple[FilePath, ...], BeforeValidator(_one_or_many), Field(min_length=1)]
    """Picture files, patterns such as ``shots/*.jpg``, or folders, in the order in which they are shown. The files of a
    pattern and the pictures of a folder come in the order of their names. In a folder, only files whose names end like
    a picture's (`PICTURE_SUFFIXES`) are taken."""
    rate: Annotated[Frequency, Field(gt=0)] = 1.0
    """How many frames come in a second of the run's clock, in hertz."""
    dwell: Duration = 0.0
    """For how long each picture is shown, in as many frames as fit; in one at least."""
    loop: bool = False
    """Whether the first picture follows the last one, until the run is ended. At a desk, each is looked at once."""

    def build(self, context: DriverContext) -> ImageFilesCamera:
        """Return the camera."""
        paths = tuple(map(str, self.paths))
        frames_each = max(1, round(self.dwell * self.rate))
        return ImageFilesCamera(paths, self.rate, context.clock, frames_each=frames_each, loops=self.loop)

    def lacks(self) -> tuple[str, ...]:
        """Return which picture no lens fits that fits the first one: a run would stop there."""
        first: tuple[str, int, int] | None = None
        try:
            files = (file for path in self.paths for file in _files_of(str(path)))
            for file in islice(files, CHECKED_MAX):
                shown = (str(file), *_size_px(file, file.stat().st_mtime_ns))
                first = first or shown
                check_one_aspect(first, shown)
        except CalibrationError as error:
            return (str(error),)
        except (PictureError, OSError):
            return ()  # reported when the file is read
        return ()


class ImageFilesCamera(RecordedCamera):
    """Shows picture files in order; a frame's ``source`` is its path.

    How pictures are converted, and that EXIF orientation is honoured: see `load_picture`.

    Args:
        frames_each: How many frames in a row show the same picture.
    """

    def __init__(
        self, paths: tuple[str, ...], rate_hz: float, clock: Clock, *, frames_each: int = 1, loops: bool = False
    ) -> None:
        super().__init__("picture files", clock, loops=loops)
        self._paths = paths
        self._files_rate_hz = rate_hz
        self._frames_each = frames_each
        self._files: Iterator[Path] = iter(())
        self._again: Iterator[tuple[Image, str]] = iter(())

    def _begin(self) -> float:
        self._files = iter(self.files())
        return self._files_rate_hz

    def files(self) -> list[Path]:
        """Return the picture files in the order in which they are shown; see `ShowsFiles`."""
        try:
            return [file for path in self._paths for file in _files_of(path)]
        except OSError as error:  # a name that is too long, for example
            raise PictureError(f"{error.filename} cannot be looked at: {error.strerror}") from error

    def _next(self) -> tuple[Image, str]:
        again = next(self._again, None)
        if again is not None:
            return again
        path = next(self._files, None)
        if path is None:
            raise EndOfFramesError("every picture has been shown")
        picture = load_picture(path)
        self._subsampling, self._optics = picture.subsampling, picture.optics
        shown = (picture.image, str(path))
        self._again = repeat(shown, self._frames_each - 1)
        return shown

    def _end(self) -> None:
        self._files, self._again = iter(()), iter(())


def _files_of(path: str) -> list[Path]:
    # A file whose name looks like a pattern, such as "ball[1].jpg", is that file.
    if Path(path).is_dir():
        return _pictures_in(Path(path))
    if Path(path).exists():
        return [Path(path)]
    if not glob.has_magic(path):
        raise PictureError(f"there is no picture and no folder {path}")
    found = sorted(file for name in glob.glob(path, recursive=True) if (file := Path(name)).is_file())  # noqa: PTH207 - Path.glob refuses absolute patterns
    if not found:
        raise PictureError(f"no file matches the pattern {path}")
    return found


def _pictures_in(folder: Path) -> list[Path]:
    try:
        found = sorted(file for file in folder.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES)
    except OSError as error:
        raise PictureError(f"the folder {folder} cannot be read: {error.strerror}") from error
    if not found:
        raise PictureError(f"there is no picture in the folder {folder}")
    return found


@lru_cache(maxsize=CHECKED_MAX)
def _size_px(file: Path, _changed_ns: int) -> tuple[int, int]:
    """Return width and height, remembered until the file changes: an editor has its text checked at each pause."""
    height_px, width_px = load_picture(file).image.shape[:2]
    return width_px, height_px
