"""A camera that plays a video file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from pydantic import Field

from stadimeter.cameras.picture import check_file
from stadimeter.cameras.recorded import RecordedCamera
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import FilePath, Frequency
from stadimeter.config.untrusted_file import PICTURE_MAX_PIXELS, is_picture
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image
from stadimeter.errors import EndOfFramesError, PictureError

# A frame rate outside this range in a video's header is a mistake of the program that wrote it.
SANE_RATES_HZ = (0.01, 1000.0)

# A video that ends before this part of the frames it announces is damaged. Headers may be a few frames out.
ENOUGH_OF_THE_FRAMES = 0.9


class VideoFileOptions(DriverOptions):
    """The options of the ``video`` camera."""

    path: FilePath
    """The video file."""
    rate: Annotated[Frequency, Field(gt=0)] | None = None
    """Its frame rate in hertz; None takes the one that the file names."""
    loop: bool = False
    """Whether it begins again at its end, until the run is ended. At a desk, it is looked through once."""

    def build(self, context: DriverContext) -> VideoFileCamera:
        """Return the camera."""
        return VideoFileCamera(self.path, self.rate, context.clock, loops=self.loop)


class VideoFileCamera(RecordedCamera):
    """Plays a video file, at a steady frame rate or that of the file, upright if its header says it was turned."""

    def __init__(self, path: Path, rate_hz: float | None, clock: Clock, *, loops: bool = False) -> None:
        super().__init__(f"the video {path}", clock, loops=loops)
        self._path = path
        self._asked_rate_hz = rate_hz
        self._capture: cv2.VideoCapture | None = None
        self._announced = 0.0
        self._read = 0
        self._ended = False
        self._subsampling = "4:2:0"  # as nearly every video has it

    def _begin(self) -> float:
        if is_picture(check_file(self._path, "video")):
            raise PictureError(f"{self._path} is a picture, not a video; the camera for it is 'images'")
        capture = cv2.VideoCapture(self._place(), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            capture.release()
            raise PictureError(f"{self._path} is not a video that OpenCV can read, or it is damaged or cut short")
        if capture.get(cv2.CAP_PROP_FRAME_WIDTH) * capture.get(cv2.CAP_PROP_FRAME_HEIGHT) > PICTURE_MAX_PIXELS:
            capture.release()
            raise PictureError(f"the video {self._path} has more than {PICTURE_MAX_PIXELS / 1e6:.0f} megapixels")
        self._capture = capture
        self._announced = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self._read, self._ended = 0, False
        return self._asked_rate_hz or self._rate_of(capture)

    def _place(self) -> str:
        """Return the path as FFmpeg needs it: without a slash at its beginning, a colon would end a protocol."""
        place = str(self._path.absolute())
        try:
            place.encode()
        except UnicodeEncodeError as error:  # OpenCV's binding ends the process at such a name
            raise PictureError(
                f"the video {self._path} has a name that is not UTF-8 text, which OpenCV cannot open; rename it"
            ) from error
        return place

    def _rate_of(self, capture: cv2.VideoCapture) -> float:
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        low_hz, high_hz = SANE_RATES_HZ
        if not (math.isfinite(rate_hz) and low_hz <= rate_hz <= high_hz):
            self._end()
            raise PictureError(
                f"the video {self._path} names no sensible frame rate ({rate_hz:g} Hz); set 'rate' for it"
            )
        return rate_hz

    def _next(self) -> tuple[Image, str]:
        if self._capture is None or self._ended:
            raise EndOfFramesError(f"the video {self._path} is at its end")
        came, image = self._capture.read()
        if not came or image is None:
            raise self._end_or_damage()
        self._read += 1
        return np.asarray(image, np.uint8), str(self._path)

    def _end_or_damage(self) -> EndOfFramesError | PictureError:
        self._ended = True
        if self._read < ENOUGH_OF_THE_FRAMES * self._announced - 1:
            return PictureError(
                f"the video {self._path} ends after {self._read} of {self._announced:.0f} frames:"
                " it is damaged or cut short"
            )
        return EndOfFramesError(f"the video {self._path} is at its end")

    def _end(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None
