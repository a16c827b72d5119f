"""A camera that shows picture files, one after the other."""

from __future__ import annotations

import glob
from collections.abc import Iterator
from functools import lru_cache
from itertools import islice, repeat
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from stadimeter.cameras.picture import PICTURE_SUFFIXES, load_picture
from stadimeter.cameras.recorded import RecordedCamera
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Duration, FilePath, Frequency
from stadimeter.core.camera_model import check_one_aspect
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError, EndOfFramesError, PictureError

# Pictures that `check` opens to compare their sizes: some seconds at most.
CHECKED_MAX = 100


def _one_or_many(value: object) -> object:
    return [value] if isinstance(value, str) else value


class ImageFilesOptions(DriverOptions):
    """The options of the ``images`` camera."""

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
