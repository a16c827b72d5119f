"""A live camera that OpenCV reads: a Video4Linux device such as a USB camera, or a network stream."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

# OpenCV waits 10 s for a frame of a Video4Linux device unless this says otherwise, in whole seconds. It is read when
# OpenCV first waits, so it is in time here even if OpenCV was imported before. A user's own setting is kept.
os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")

import cv2
import numpy as np

from stadimeter.cameras import opencv_settings
from stadimeter.cameras.capture_time import BLIND_SETTLE_S, ArrivalPace, DriverStamp, KernelTime, StreamTime
from stadimeter.cameras.live_camera import CapturedPicture, LiveCamera
from stadimeter.cameras.mjpeg_stream import JpegStream
from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.cameras.v4l2 import NOT_OURS, ask_node, attached_devices, in_use, is_in_use
from stadimeter.config.plugins import DriverContext
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image, SeenPictures
from stadimeter.errors import CaptureTimeoutError, DeviceOpenError, LinkLostError, PictureError

# Time limit for a device's first frame: USB cameras start slowly.
FIRST_FRAME_S = 3.0

MJPG = cv2.VideoWriter.fourcc(*"MJPG")

# Time limit for a stream's answer.
STREAM_OPEN_S = 5.0

# Time limit for FFmpeg to deliver what waited while it opened a stream without time stamps.
FFMPEG_SETTLE_S = 2.0

# Time that OpenCV waits for a device's frame at a time, as set above.
DEVICE_WAIT_S = 1.0


class OpenCvOptions(opencv_settings.OpenCvSettings):
    """The options of the ``opencv`` camera."""

    def build(self, context: DriverContext) -> OpenCvCamera:
        """Return the camera."""
        return OpenCvCamera(self, context.clock, cv2.VideoCapture)

    @staticmethod
    def attached() -> tuple[AttachedCamera, ...]:
        """Return the Video4Linux devices that give pictures."""
        return attached_devices()

    def lacks(self) -> tuple[str, ...]:
        """List the things that keep a device from being opened, as far as that shows without opening it."""
        if self.device_file is not None or self.is_stream:
            return ()
        trouble = _why_not_ours(self.source(), self.name)
        return (trouble,) if trouble else ()


# Opens a device or stream: ``cv2.VideoCapture``. Takes the source, the API and its parameters.
OpenCapture = Callable[[str, int, Sequence[int]], opencv_settings.CaptureLike]


class OpenCvCamera(LiveCamera):
    """A Video4Linux device or a network stream, read through OpenCV.

    A frame's capture time is the driver's stamp where it can be trusted (see `DriverStamp`), else its arrival less the
    stated ``latency`` and the lag that shows (see `StreamTime`). Frames that waited on the way are passed over, and so
    are damaged ones. Streams of JPEG pictures over HTTP are read by `MjpegStream`, all others by FFmpeg. Settings that
    the device did not take are no error; they are in `remarks`.

    OpenCV's capture object may not be used by two threads at a time, nor can a read be broken off: a `close` lets it
    end.

    Args:
        open_capture: Opens the device; another one than OpenCV's is for tests.
        monotonic: The clock of the device's stamps; another one is for tests.
    """

    def __init__(
        self,
        options: OpenCvOptions,
        clock: Clock,
        open_capture: OpenCapture = cv2.VideoCapture,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(options.name)
        self._options = options
        self._clock = clock
        self._open_capture = open_capture
        self._source = ""
        self._subsampling = opencv_settings.subsampling_of(options)
        self._capture: opencv_settings.CaptureLike | None = None
        self._jpegs: JpegStream | None = None
        self._kernel_time = KernelTime(monotonic)
        self._stamp = DriverStamp(options.frame_latency_s())
        self._stream_time = StreamTime(options.frame_latency_s())
        self._pace = ArrivalPace()
        self._seen = SeenPictures()
        self._last_captured_at_s = 0.0
        self._position = 0.0
        self._exposure_s: float | None = None
        self.not_for_motion = self._why_not_for_motion()

    def _release(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _acquire(self) -> tuple[str, ...]:
        self._source = self._options.source()  # anew each time: the password in a file may have changed
        self.not_for_motion = self._why_not_for_motion()
        capture = self._capture = self._opened_stream() if self._options.is_stream else self._opened_device()
        self._stamp.restart()
        self._pace = ArrivalPace()
        self._position = 0.0
        differ = () if self._options.is_stream else opencv_settings.apply_settings(capture, self._options)
        self._exposure_s = opencv_settings.fixed_exposure_s(capture, self._options)
        is_jpeg = not self._options.is_stream and capture.get(cv2.CAP_PROP_FOURCC) == MJPG
        is_jpeg = is_jpeg and capture.set(cv2.CAP_PROP_CONVERT_RGB, 0.0)
        self._jpegs = JpegStream() if is_jpeg else None
        try:
            image = self._first_picture(capture).image
        except (CaptureTimeoutError, LinkLostError) as error:
            asked = f" ({'; '.join(differ)})" if differ else ""
            raise DeviceOpenError(f"the camera {self._name} opens but gives no picture{asked}") from error
        if is_jpeg and self._jpegs is None:
            differ += ("libjpeg finds damage in each of its pictures, so further damage goes unnoticed",)
        return differ + opencv_settings.size_differs(image, self._options)

    def _first_picture(self, capture: opencv_settings.CaptureLike) -> CapturedPicture:
        """Wait for the first picture; of a camera whose every JPEG seems damaged, take it as OpenCV decodes it."""
        try:
            return self._next_picture(capture, FIRST_FRAME_S)
        except CaptureTimeoutError as error:
            if self._jpegs is None or "damaged" not in str(error):
                raise
        self._jpegs = None
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 1.0)
        return self._next_picture(capture, FIRST_FRAME_S)

    def _next(self) -> CapturedPicture:
        if self._capture is None:
            raise self._not_open()
        return self._next_picture(self._capture, self._options.read_timeout)

    def _why_not_for_motion(self) -> str:
        """Say whether it is a stream of unknown age, or one that loses packets."""
        return next(iter(self._options.refuse_motion().values()), "")

    def _opened_device(self) -> opencv_settings.CaptureLike:
        if trouble := _why_not_ours(self._source, self._name):
            raise DeviceOpenError(trouble)
        capture = self._open_capture(self._source, cv2.CAP_V4L2, ())
        if not capture.isOpened():
            raise DeviceOpenError(f"the camera {self._name} cannot be opened: {_why_not(Path(self._source))}")
        return capture

    def _opened_stream(self) -> opencv_settings.CaptureLike:
        if self._options.scheme in {"http", "https"}:
            from stadimeter.cameras.mjpeg_stream import open_mjpeg  # noqa: PLC0415 - most runs never need it

            try:
                stream = open_mjpeg(self._source, STREAM_OPEN_S, self._options.read_timeout, self._seen)
            except DeviceOpenError as error:
                raise DeviceOpenError(f"the stream {self._name} cannot be opened: {error}") from error
            if stream is not None:
                self._stream_time.restart()
                return stream
        self._stream_time.restart(FFMPEG_SETTLE_S)
        limits = {
            cv2.CAP_PROP_OPEN_TIMEOUT_MSEC: STREAM_OPEN_S,
            cv2.CAP_PROP_READ_TIMEOUT_MSEC: self._options.read_timeout,
        }
        params = [number for key, limit_s in limits.items() for number in (key, max(1, round(1e3 * limit_s)))]
        capture = self._open_capture(self._source, cv2.CAP_FFMPEG, params)
        if not capture.isOpened():
            raise DeviceOpenError(
                f"the stream {self._name} cannot be opened; is its sender running, and the path right?"
            )
        return capture

    def _next_picture(self, capture: opencv_settings.CaptureLike, limit_s: float) -> CapturedPicture:
        """Wait for a picture that is whole and did not wait."""
        began_s = self._clock.now_s()
        passed_over = {"damaged": 0, "late": 0}
        while True:
            self._check_open()
            grab_began_s = self._clock.now_s()
            if capture.grab():
                captured_at_s = self._captured_at_s(capture)
                if captured_at_s is None:
                    passed_over["late"] += 1
                elif (image := _decoded(capture, self._jpegs)) is not None:
                    return CapturedPicture(image, captured_at_s, self._exposure_s)
                else:
                    passed_over["damaged"] += 1
            elif self._clock.now_s() - grab_began_s < 0.5 * min(DEVICE_WAIT_S, self._options.read_timeout):
                raise LinkLostError(self._loss())
            waited_s = self._clock.now_s() - began_s
            # Opening a stream anew leaves behind what a sender kept, but takes longer than a pace does to be believed.
            if waited_s >= limit_s + (BLIND_SETTLE_S if passed_over["late"] else 0.0):
                raise CaptureTimeoutError(
                    f"the camera {self._name} gave no whole picture for {waited_s:.1f} s{self._in_words(passed_over)}"
                )

    def _in_words(self, passed_over: dict[str, int]) -> str:
        came = ", ".join(f"{number} {what}" for what, number in passed_over.items() if number)
        why = f": {self._stream_time.why_late}" if passed_over["late"] and self._stream_time.why_late else ""
        return f" ({came}{why})" if came else ""

    def _captured_at_s(self, capture: opencv_settings.CaptureLike) -> float | None:
        """Return when the grabbed frame was captured, or None if it waited on the way."""
        arrived_at_s = self._clock.now_s()
        pictures = self._pictures(capture)
        stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        if self._options.is_stream:
            has_begun = getattr(capture, "has_begun", None)  # `MjpegStream` knows it, OpenCV does not
            captured_at_s = self._stream_time.captured_at_s(arrived_at_s, stamp_s, pictures, has_begun=has_begun)
            if captured_at_s is not None and getattr(capture, "came_before", False):
                return self._last_captured_at_s  # an old picture, which shows nothing of what was since
            self._last_captured_at_s = captured_at_s or self._last_captured_at_s
            return captured_at_s
        captured_at_s = self._stamp.captured_at_s(self._kernel_time.on_run_clock(stamp_s, arrived_at_s), arrived_at_s)
        waited = self._pace.waited(arrived_at_s, pictures)
        return captured_at_s if self._stamp.is_trusted or not waited else None

    def _pictures(self, capture: opencv_settings.CaptureLike) -> int:
        """Return the number of frames that have come since the last one that was grabbed."""
        before, self._position = self._position, capture.get(cv2.CAP_PROP_POS_FRAMES)
        return max(1, round(self._position - before))

    def _loss(self) -> str:
        if self._options.is_stream:
            return f"the stream {self._name} has ended or its connection is lost"
        if not Path(self._source).exists():
            return f"{self._name} is gone; is the camera's cable loose?"
        return f"the camera {self._name} has stopped answering"


def _why_not(node: Path) -> str:
    if node.is_file():
        return "it is a file; the driver 'video' plays video files, 'images' shows pictures"
    if is_in_use(node):
        return in_use(str(node.resolve()))
    with suppress(OSError):
        if not ask_node(node).gives_pictures:
            return "it is not the node that gives pictures; `stadimeter cameras` lists those that do"
    return "it does not answer as a camera does; unplug it and plug it in again"


def _decoded(capture: opencv_settings.CaptureLike, jpegs: JpegStream | None) -> Image | None:
    """Return the grabbed frame as a colour picture, or None if it is damaged: USB cameras send such ones at times.

    A JPEG comes as one row of its bytes. OpenCV's own decoder would fill in what is missing.
    """
    try:
        came, image = capture.retrieve()
        if came and jpegs is not None and image is not None and image.shape[0] == 1:
            return jpegs.decode(image.tobytes())
    except (cv2.error, PictureError):
        return None
    if not came or image is None or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        return None
    return np.asarray(image, np.uint8)


def _why_not_ours(source: str, name: str) -> str:
    """Return why a device cannot be opened, as far as that shows without opening it; empty if nothing does."""
    if not Path(source).exists():
        return f"there is no camera {name}; is it plugged in? `stadimeter cameras` lists those that are there"
    if not os.access(source, os.R_OK | os.W_OK):
        return f"the camera {name} cannot be opened: {NOT_OURS}"
    return ""
