"""The way the options of a camera that OpenCV reads are applied to a Video4Linux device."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, Any, Protocol, Self

import cv2
from pydantic import BeforeValidator, Field, model_validator

from stadimeter.config.addresses import address_for_people, address_in
from stadimeter.config.plugins import DriverOptions
from stadimeter.config.units import Duration, FilePath, Frequency
from stadimeter.core.frame import Image, Subsampling
from stadimeter.errors import DeviceOpenError

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
