"""A live camera that OpenCV reads: a Video4Linux device such as a USB camera, or a network stream."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Protocol, Self

import cv2
import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from stadimeter.cameras.capture_time import BLIND_SETTLE_S, ArrivalPace, DriverStamp, KernelTime, StreamTime
from stadimeter.cameras.live_camera import CapturedPicture, LiveCamera
from stadimeter.cameras.mjpeg_stream import JpegStream
from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.cameras.v4l2 import NOT_OURS, ask_node, attached_devices, in_use, is_in_use
from stadimeter.config.addresses import address_for_people, address_in
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Duration, FilePath, Frequency
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image, SeenPictures, Subsampling
from stadimeter.errors import CaptureTimeoutError, DeviceOpenError, LinkLostError, PictureError

# The way the options of a camera that OpenCV reads are applied to a Video4Linux device.

# The unit of V4L2_CID_EXPOSURE_ABSOLUTE (Linux Media API, camera control reference).
EXPOSURE_UNIT_S = 100e-6

# The menu values of V4L2_CID_EXPOSURE_AUTO: manual, and aperture priority, which is what UVC cameras offer.
AUTO_EXPOSURE_MANUAL = 1
AUTO_EXPOSURE_ON = 3


# Schemes of addresses whose bytes all arrive, or none after the first that is lost. RTSP is asked for over TCP.
RELIABLE_TRANSPORTS = frozenset({"file", "http", "https", "rtmp", "rtmps", "rtsp", "rtsps", "tcp", "tls"})

FFMPEG_OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
# OpenCV would ask for RTSP over TCP, and take UDP if the sender has nothing else. A user's own setting is kept.
os.environ.setdefault(FFMPEG_OPTIONS, "rtsp_transport;tcp")


def _check_device(value: object) -> object:
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    if isinstance(value, str) and (value.startswith("/") or "://" in value):
        return value
    words = "this" if isinstance(value, str) and "@" in value else repr(value)  # it may hold a password
    raise ValueError(
        f"{words} is not a camera; write a number such as 0, a path such as '/dev/v4l/by-id/…-index0',"
        " or an address such as 'rtsp://…'"
    )


class OpenCvSettings(DriverOptions):
    """The table of the ``opencv`` camera, without its driver."""

    device: Annotated[int | str, BeforeValidator(_check_device)] | None = None
    """A number, 0 for ``/dev/video0``; a path such as ``/dev/v4l/by-id/…-index0``; or the address of a stream such as
    ``rtsp://…`` or ``http://…``. An address with a password is better kept in a `device_file`."""
    device_file: FilePath | None = None
    """A text file with the address of a stream on its first line. It may be a systemd credential."""
    width_px: Annotated[int, Field(gt=0, le=20_000)] | None = None
    """The width to ask for, together with ``height_px``; None takes what the camera gives."""
    height_px: Annotated[int, Field(gt=0, le=20_000)] | None = None
    """The height to ask for."""
    rate: Annotated[Frequency, Field(gt=0)] | None = None
    """The frame rate to ask for in hertz; None takes what the camera gives."""
    fourcc: Annotated[str, Field(pattern=r"^[ -~]{4}$")] = "MJPG"
    """The pixel format to ask a device for. MJPG lets most USB cameras send large pictures at full rate."""
    exposure: Annotated[Duration, Field(gt=0)] | None = None
    """The exposure time in seconds; None leaves it to the camera."""
    autofocus: bool = False
    """Whether the camera may refocus. It changes the focal length, and so every distance; off unless asked."""
    read_timeout: Annotated[Duration, Field(gt=0, le=60)] = 1.0
    """How long to wait for a frame, in seconds."""
    latency: Annotated[Duration, Field(le=60)] | None = None
    """How old a picture is when it arrives, in seconds: from the exposure to its arrival here. It counts into the age
    of every frame that has no capture time. Without it nothing may move on the frames of a stream."""
    accept_lossy_stream: bool = False
    """Whether something may move on a stream that comes over UDP, SRT or the like, where packets are lost. A decoder
    then shows old parts of the picture as if they were new."""

    @model_validator(mode="after")
    def _one_camera_only(self) -> Self:
        if (self.device is None) is (self.device_file is None):
            raise ValueError("a camera needs either device or device_file")
        return self

    @model_validator(mode="after")
    def _size_is_whole(self) -> Self:
        if (self.width_px is None) != (self.height_px is None):
            raise ValueError("width_px and height_px go together; write both or neither")
        return self

    @property
    def is_stream(self) -> bool:
        """True if the device is the address of a stream."""
        return self.device_file is not None or (isinstance(self.device, str) and "://" in self.device)

    @property
    def name(self) -> str:
        """The camera's name in messages: its path or address, without what may be a secret in it."""
        if self.device_file is not None:
            return f"named in {self.device_file}"
        return f"/dev/video{self.device}" if isinstance(self.device, int) else address_for_people(self.device or "")

    def source(self) -> str:
        """Return the path of the device, or the address of the stream, which may hold a password.

        Raises:
            DeviceOpenError: The file with the address cannot be read.
        """
        if self.device_file is not None:
            return address_in(self.device_file, "rtsp://…")
        return f"/dev/video{self.device}" if isinstance(self.device, int) else self.device or ""

    @property
    def scheme(self) -> str:
        """The scheme of a stream's address, such as ``rtsp``; empty for a device and an address that cannot be read."""
        with suppress(DeviceOpenError):
            return self.source().partition("://")[0].lower() if self.is_stream else ""
        return ""

    def frame_latency_s(self) -> float:
        """Return the stated latency."""
        return self.latency or 0.0

    def refuse_motion(self) -> dict[str, str]:
        """Return why nothing may move on its frames: a sentence for each option that has to be written."""
        why: dict[str, str] = {}
        if self.is_stream and self.latency is None:
            why["latency"] = (
                "how old the pictures of a stream are is not known, so nothing moves on them;"
                ' measure it and write such as latency = "150 ms" in [camera]'
            )
        if self._loses_packets() and not self.accept_lossy_stream:
            why["accept_lossy_stream"] = (
                f"packets of {self.scheme}:// get lost, and old parts of the picture then look like new ones, so"
                " nothing moves on it; send it over TCP, or write accept_lossy_stream = true in [camera]"
            )
        return why

    def _loses_packets(self) -> bool:
        if self.scheme == "rtsp":
            return "rtsp_transport;tcp" not in os.environ.get(FFMPEG_OPTIONS, "")
        return self.scheme != "" and self.scheme not in RELIABLE_TRANSPORTS


_SUBSAMPLINGS: dict[str, Subsampling] = {
    **dict.fromkeys(("YUYV", "UYVY", "YVYU", "VYUY", "NV16", "422P"), "4:2:2"),
    **dict.fromkeys(("RGB3", "BGR3", "GREY", "Y800", "Y16 "), "4:4:4"),
}


def subsampling_of(options: OpenCvSettings) -> Subsampling:
    """Return the subsampling of a camera's colour, by its pixel format. MJPEG, video and all others: 4:2:0."""
    return "4:2:0" if options.is_stream else _SUBSAMPLINGS.get(options.fourcc.upper(), "4:2:0")


class CaptureLike(Protocol):
    """The part of ``cv2.VideoCapture`` that the driver uses."""

    def isOpened(self) -> bool: ...  # noqa: D102, N802 - OpenCV's name and meaning
    def grab(self) -> bool: ...  # noqa: D102
    def retrieve(self) -> tuple[bool, Any]: ...  # noqa: D102
    def get(self, prop: int, /) -> float: ...  # noqa: D102
    def set(self, prop: int, value: float, /) -> bool: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


def apply_settings(capture: CaptureLike, options: OpenCvSettings) -> tuple[str, ...]:
    """Apply the options to an open device in the order that drivers need; return a sentence on each not taken.

    The pixel format decides which sizes there are, the size which frame rates, the frame rate how long an exposure can
    be. Drivers substitute silently what they do not have. The size is not read back: the first picture shows it.
    """
    found = [*_apply_format(capture, options)]
    if options.width_px is not None and options.height_px is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, options.width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, options.height_px)
    for apply in (_apply_rate, _apply_exposure, _apply_focus):
        found += apply(capture, options)
    return tuple(found)


def size_differs(image: Image, options: OpenCvSettings) -> tuple[str, ...]:
    """Return a sentence if a picture has another size than was asked for."""
    height_px, width_px = image.shape[:2]
    if options.width_px is None or (options.width_px, options.height_px) == (width_px, height_px):
        return ()
    asked = f"{options.width_px} × {options.height_px}"
    return (f"asked for pictures of {asked} pixels, the camera gives {width_px} × {height_px}",)


def _apply_format(capture: CaptureLike, options: OpenCvSettings) -> Iterator[str]:
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*options.fourcc))
    code = max(0, int(capture.get(cv2.CAP_PROP_FOURCC)))
    found = (code & 0xFFFFFFFF).to_bytes(4, "little").decode("latin-1")
    if found != options.fourcc:
        yield f"asked for the pixel format {options.fourcc}, the camera gives {found if code else 'another'}"


def _apply_rate(capture: CaptureLike, options: OpenCvSettings) -> Iterator[str]:
    if options.rate is None:
        return
    capture.set(cv2.CAP_PROP_FPS, options.rate)
    found_hz = capture.get(cv2.CAP_PROP_FPS)
    if abs(found_hz - options.rate) > 0.01 * options.rate:
        yield f"asked for {options.rate:g} frames a second, the camera says {found_hz:g}"


def _apply_exposure(capture: CaptureLike, options: OpenCvSettings) -> Iterator[str]:
    if options.exposure is None:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, AUTO_EXPOSURE_ON)
        # A camera without the control answers 0 or below; it exposes as it likes, which is what was asked for.
        if capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) == AUTO_EXPOSURE_MANUAL:
            yield "asked for automatic exposure, the camera stays at manual"
        return
    capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, AUTO_EXPOSURE_MANUAL)
    if capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) != AUTO_EXPOSURE_MANUAL:
        yield "asked for manual exposure, the camera does not switch to it"
    steps = max(1, round(options.exposure / EXPOSURE_UNIT_S))
    capture.set(cv2.CAP_PROP_EXPOSURE, steps)
    found_s = capture.get(cv2.CAP_PROP_EXPOSURE) * EXPOSURE_UNIT_S
    if abs(found_s - steps * EXPOSURE_UNIT_S) > EXPOSURE_UNIT_S / 2:
        yield f"asked for an exposure of {1e3 * options.exposure:g} ms, the camera says {1e3 * found_s:g} ms"


def fixed_exposure_s(capture: CaptureLike, options: OpenCvSettings) -> float | None:
    """Return the exposure time that the device says it holds; None where it chooses it itself, or does not say.

    While the exposure is automatic, most devices name the last fixed one instead of what they use.
    """
    if options.is_stream or options.exposure is None:
        return None
    is_fixed = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) == AUTO_EXPOSURE_MANUAL
    steps = capture.get(cv2.CAP_PROP_EXPOSURE)
    return steps * EXPOSURE_UNIT_S if is_fixed and steps > 0 else None


def _apply_focus(capture: CaptureLike, options: OpenCvSettings) -> Iterator[str]:
    capture.set(cv2.CAP_PROP_AUTOFOCUS, float(options.autofocus))
    is_on = capture.get(cv2.CAP_PROP_AUTOFOCUS) > 0
    if is_on and not options.autofocus:
        yield "asked for a fixed focus, the camera keeps refocusing: distances will drift"
    if options.autofocus and not is_on:
        yield "asked for autofocus, the camera has none"


# OpenCV waits 10 s for a frame of a Video4Linux device unless this says otherwise, in whole seconds. It is read when
# OpenCV first waits, so it is in time here even if OpenCV was imported before. A user's own setting is kept.
os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")


# Time limit for a device's first frame: USB cameras start slowly.
FIRST_FRAME_S = 3.0

MJPG = cv2.VideoWriter.fourcc(*"MJPG")

# Time limit for a stream's answer.
STREAM_OPEN_S = 5.0

# Time limit for FFmpeg to deliver what waited while it opened a stream without time stamps.
FFMPEG_SETTLE_S = 2.0

# Time that OpenCV waits for a device's frame at a time, as set above.
DEVICE_WAIT_S = 1.0


class OpenCvOptions(OpenCvSettings):
    """The options of a USB camera, or of a stream by its address."""

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
OpenCapture = Callable[[str, int, Sequence[int]], CaptureLike]


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
        self._subsampling = subsampling_of(options)
        self._capture: CaptureLike | None = None
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
        differ = () if self._options.is_stream else apply_settings(capture, self._options)
        self._exposure_s = fixed_exposure_s(capture, self._options)
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
        return differ + size_differs(image, self._options)

    def _first_picture(self, capture: CaptureLike) -> CapturedPicture:
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

    def _opened_device(self) -> CaptureLike:
        if trouble := _why_not_ours(self._source, self._name):
            raise DeviceOpenError(trouble)
        capture = self._open_capture(self._source, cv2.CAP_V4L2, ())
        if not capture.isOpened():
            raise DeviceOpenError(f"the camera {self._name} cannot be opened: {_why_not(Path(self._source))}")
        return capture

    def _opened_stream(self) -> CaptureLike:
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

    def _next_picture(self, capture: CaptureLike, limit_s: float) -> CapturedPicture:
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

    def _captured_at_s(self, capture: CaptureLike) -> float | None:
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

    def _pictures(self, capture: CaptureLike) -> int:
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


def _decoded(capture: CaptureLike, jpegs: JpegStream | None) -> Image | None:
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
