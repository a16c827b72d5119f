"""A camera that shows picture files, one after the other."""

from __future__ import annotations

import glob
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from stadimeter.cameras.picture import PICTURE_SUFFIXES, load_picture
from stadimeter.cameras.recorded import RecordedCamera
from stadimeter.config.plugins import DriverContext, Options, Plugin
from stadimeter.config.units import FilePath, Frequency
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image
from stadimeter.errors import EndOfFramesError, PictureError


def _one_or_many(value: object) -> object:
    return [value] if isinstance(value, str) else value


class ImageFilesOptions(Options):
    """The options of the ``images`` camera."""

    paths: Annotated[tuple[FilePath, ...], BeforeValidator(_one_or_many), Field(min_length=1)]
    """Picture files, patterns such as ``shots/*.jpg``, or folders, in the order in which they are shown. The files of a
    pattern and the pictures of a folder come in the order of their names. In a folder, only files whose names end like
    a picture's (`PICTURE_SUFFIXES`) are taken."""
    rate: Annotated[Frequency, Field(gt=0)] = 1.0
    """How many pictures are shown in a second of the run's clock, in hertz."""


class ImageFilesCamera(RecordedCamera):
    """Shows picture files in order, each once; a frame's ``source`` is its path.

    How pictures are converted, and that EXIF orientation is honoured: see `load_picture`.
    """

    def __init__(self, paths: tuple[str, ...], rate_hz: float, clock: Clock) -> None:
        super().__init__("picture files", clock)
        self._paths = paths
        self._files_rate_hz = rate_hz
        self._files: Iterator[Path] = iter(())

    def _begin(self) -> float:
        try:
            self._files = iter([file for path in self._paths for file in _files_of(path)])
        except OSError as error:  # a name that is too long, for example
            raise PictureError(f"{error.filename} cannot be looked at: {error.strerror}") from error
        return self._files_rate_hz

    def _next(self) -> tuple[Image, str]:
        path = next(self._files, None)
        if path is None:
            raise EndOfFramesError("every picture has been shown")
        picture = load_picture(path)
        self._subsampling, self._optics = picture.subsampling, picture.optics
        return picture.image, str(path)

    def _end(self) -> None:
        self._files = iter(())


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


def _build(options: ImageFilesOptions, context: DriverContext) -> ImageFilesCamera:
    return ImageFilesCamera(tuple(str(path) for path in options.paths), options.rate, context.clock)


PLUGIN = Plugin(ImageFilesOptions, _build)
