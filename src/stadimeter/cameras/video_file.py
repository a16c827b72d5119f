"""A camera that plays a video file."""

from __future__ import annotations

import math
from collections import deque
from itertools import islice
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from pydantic import Field

from stadimeter.cameras.image_files import RecordedCamera, check_file
from stadimeter.config.files import PICTURE_MAX_PIXELS, is_picture
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import FilePath, Frequency
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image
from stadimeter.errors import EndOfFramesError, PictureError

# A frame rate outside this range in a video's header is a mistake of the program that wrote it.
SANE_RATES_HZ = (0.01, 1000.0)

# Files of JPEGs behind one another, as `rpicam-vid --codec mjpeg` writes: they begin as pictures do, and have no times.
JPEGS_IN_A_ROW = {".mjpeg", ".mjpg"}

# So many pictures are looked through for one that differs from the first: two seconds of most videos.
STILL_MAX = 60

# A video that ends before this part of the frames it announces is damaged. Headers may be a few frames out.
ENOUGH_OF_THE_FRAMES = 0.9


class VideoFileOptions(DriverOptions):
    """The options of a video file as a camera."""

    path: FilePath
    """The video file."""
    rate: Annotated[Frequency, Field(gt=0)] | None = None
    """Its frame rate in hertz; None takes the times that the file has."""
    loop: bool = False
    """Whether it begins again at its end, until the run is ended. At a desk, it is looked through once."""

    def build(self, context: DriverContext) -> VideoFileCamera:
        """Return the camera."""
        return VideoFileCamera(self.path, self.rate, context.clock, loops=self.loop)


class VideoFileCamera(RecordedCamera):
    """Plays a video file, at a steady frame rate or at the times of the file, upright if its header says it was turned.

    A file without times, such as raw H.264, is played at the rate that FFmpeg guesses, and a remark says so.
    """

    def __init__(self, path: Path, rate_hz: float | None, clock: Clock, *, loops: bool = False) -> None:
        super().__init__(f"the video {path}", clock, loops=loops)
        self._path = path
        self._asked_rate_hz = rate_hz
        self._capture: cv2.VideoCapture | None = None
        self._announced = 0.0
        self._read = 0
        self._ended = False
        self._ahead: deque[tuple[Image, float]] = deque()
        self._stamp_s = math.nan
        self._has_times = False
        self._subsampling = "4:2:0"  # as nearly every video has it

    def _begin(self) -> float:
        begins_as_picture = is_picture(check_file(self._path, "video"))
        is_row = begins_as_picture and self._path.suffix.lower() in JPEGS_IN_A_ROW
        if begins_as_picture and not is_row:
            remedy = "the camera for one is 'images'; several JPEGs behind one another need a name that ends in .mjpeg"
            raise PictureError(f"{self._path} begins as a picture, not as a video: {remedy}")
        capture = self._opened()
        if capture.get(cv2.CAP_PROP_FRAME_WIDTH) * capture.get(cv2.CAP_PROP_FRAME_HEIGHT) > PICTURE_MAX_PIXELS:
            capture.release()
            raise PictureError(f"the video {self._path} has more than {PICTURE_MAX_PIXELS / 1e6:.0f} megapixels")
        self._capture = capture
        self._announced = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self._read, self._ended, self._stamp_s = 0, False, math.nan
        rate_hz = self._asked_rate_hz or self._rate_of(capture)
        self._look_ahead(capture)
        stamps_s = [stamp_s for _, stamp_s in self._ahead]
        self._has_times = self._asked_rate_hz is None and not is_row and stamps_s[:1] < stamps_s[1:2]
        if self._asked_rate_hz is None and len(stamps_s) > 1 and not self._has_times:
            words = f"the video {self._path} has no times: {rate_hz:g} Hz is a guess, and every speed with it"
            self.remarks = (f"{words}; write its 'rate' in [camera]",)
        return rate_hz

    def _opened(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(self._place(), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            capture.release()
            raise PictureError(f"{self._path} is not a video that OpenCV can read, or it is damaged or cut short")
        return capture

    def _look_ahead(self, capture: cv2.VideoCapture) -> None:
        """Read up to the second picture that differs, and refuse what OpenCV cannot convert, as interlaced video.

        OpenCV 5 says of such a frame that it was read, and gives what its memory held: nothing, or another picture.
        """
        self._ahead.clear()
        for image, stamp_s in islice(iter(lambda: _decoded(capture), None), STILL_MAX):
            is_still = not self._ahead or np.array_equal(image, self._ahead[0][0])
            self._ahead.append((self._ahead[0][0] if self._ahead and is_still else image, stamp_s))
            if not is_still:
                return
        if len(self._ahead) > 1:
            first, again = self._ahead[0][0], self._opened()
            second = _decoded(again)
            again.release()
            if not first.any() or second is None or not np.array_equal(first, second[0]):
                self._end()
                raise PictureError(
                    f"the video {self._path} gives no pictures, only black or what was in memory: it is interlaced,"
                    f" which OpenCV {cv2.__version__} cannot convert, or black; `ffmpeg -i {self._path.name} -vf yadif"
                    " NEW.mp4` makes it progressive"
                )

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
        found = self._ahead.popleft() if self._ahead else _decoded(self._capture)
        if found is None:
            raise self._end_or_damage()
        self._read += 1
        image, stamp_s = found
        if self._has_times:
            step_s = stamp_s - self._stamp_s
            steady_s = 1.0 / self._capture.get(cv2.CAP_PROP_FPS)
            self._played_s = 0.0 if self._played_s is None else self._played_s + (step_s if step_s > 0.0 else steady_s)
            self._stamp_s = stamp_s
        return image, str(self._path)

    def _end_or_damage(self) -> EndOfFramesError | PictureError:
        self._ended = True
        if not self._read or self._read < ENOUGH_OF_THE_FRAMES * self._announced - 1:
            other = f", or of a kind that OpenCV lacks, as AV1; `ffmpeg -i {self._path.name} NEW.mp4` converts it"
            ends = f"the video {self._path} ends after {self._read} of {self._announced:.0f} frames"
            return PictureError(f"{ends}: it is damaged or cut short{'' if self._read else other}")
        return EndOfFramesError(f"the video {self._path} is at its end")

    def _end(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None
            self._ahead.clear()


def _decoded(capture: cv2.VideoCapture) -> tuple[Image, float] | None:
    """Return the next picture, and its time in the file in seconds; None at the end."""
    came, image = capture.read()
    if not came or image is None:
        return None
    return np.asarray(image, np.uint8), capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
