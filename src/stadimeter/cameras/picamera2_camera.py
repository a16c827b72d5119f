"""A Raspberry Pi's own camera, on the ribbon cable, read through libcamera by the package picamera2."""

from __future__ import annotations

import logging
import math
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Annotated, Any, Literal, Self

import numpy as np
from msgspec import Struct
from pydantic import Field, model_validator

from stadimeter import errors
from stadimeter.cameras.capture_time import KernelTime
from stadimeter.cameras.live_camera import CLOSE_WAIT_S, CapturedPicture, LiveCamera
from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.cameras.v4l2 import in_use
from stadimeter.config import extras
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Duration, FilePath, Frequency, Length
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image, Optics, SensorBoxes

# The controls that the options of a Raspberry Pi's own camera become, and what the camera did not take ----------------

# What libcamera says of one frame, by the names of its controls.
Metadata = Mapping[str, Any]

# The controls that a camera has: the least, greatest and default value of each.
Controls = Mapping[str, tuple[Any, Any, Any]]

# Picamera2's own size of video frames.
SIZE_PX = (1280, 720)

# Picamera2's own rate of video frames.
RATE_HZ = 30.0

MAX_EXPOSURE_S = 0.5

# The names of libcamera's ``AwbModeEnum``, in small letters.
WhiteBalance = Literal["auto", "incandescent", "tungsten", "fluorescent", "indoor", "daylight", "cloudy"]


class Picamera2Settings(DriverOptions):
    """The table of the ``picamera2`` camera, without its driver."""

    camera: Annotated[int, Field(ge=0)] | str = 0
    """The camera: its number, 0 for the first; its model such as ``imx708``; or the path that `stadimeter cameras`
    shows, which means the socket that it is plugged into."""
    width_px: Annotated[int, Field(gt=0, le=20_000, multiple_of=2)] = SIZE_PX[0]
    """The width of the pictures, an even number."""
    height_px: Annotated[int, Field(gt=0, le=20_000, multiple_of=2)] = SIZE_PX[1]
    """Their height, an even number."""
    sensor_width_px: Annotated[int, Field(gt=0, le=20_000)] | None = None
    """The width that the sensor itself reads out, together with ``sensor_height_px``: its mode. Some modes show a part
    of the view only. None leaves the choice to libcamera, which goes by the size of the pictures."""
    sensor_height_px: Annotated[int, Field(gt=0, le=20_000)] | None = None
    """The height that the sensor itself reads out."""
    crop_px: tuple[int, int, int, int] | None = None
    """The part of the sensor that fills the picture: left, top, width and height in the sensor's own pixels. None takes
    all that the mode shows and the picture's aspect allows."""
    upside_down: bool = False
    """Whether the camera is mounted upside down; its pictures are then turned by half a turn."""
    rate: Annotated[Frequency, Field(gt=0)] | None = None
    """The frame rate in hertz; None takes 30, or what the exposure leaves."""
    exposure: Annotated[Duration, Field(gt=0, le=MAX_EXPOSURE_S)] | None = None
    """The exposure time in seconds; None leaves it to the camera."""
    gain: Annotated[float, Field(ge=1, le=1000)] | None = None
    """The analogue gain, 1 for none; None leaves it to the camera."""
    white_balance: WhiteBalance = "auto"
    """The light, within which the camera balances its colours itself."""
    colour_gains: tuple[Annotated[float, Field(gt=0, le=32)], Annotated[float, Field(gt=0, le=32)]] | None = None
    """The gains of red and blue beside green: a fixed white balance. Colours then stay the same."""
    focus: Annotated[Length, Field(gt=0)] | None = None
    """The distance to focus on, in metres, for a camera whose lens has a motor. The lens stays there."""
    lens_position_dpt: Annotated[float, Field(ge=0, le=32)] | None = None
    """The same in dioptres, one through the distance in metres; 0 for infinity."""
    autofocus: bool = False
    """Whether the camera may refocus. It changes the focal length, and so every distance; off unless asked."""
    network: FilePath | None = None
    """The network that an AI camera (IMX500) runs on its sensor: a post-processed one that finds objects, such as
    ``/usr/share/imx500-models/imx500_network_ssd_mobilenetv2_fpnlite_320x320_pp.rpk``. For `object` without a model."""
    read_timeout: Annotated[Duration, Field(gt=0, le=60)] = 1.0
    """How long to wait for a frame, in seconds."""

    @model_validator(mode="after")
    def _sensor_size_is_whole(self) -> Self:
        if (self.sensor_width_px is None) != (self.sensor_height_px is None):
            raise ValueError("sensor_width_px and sensor_height_px go together; write both or neither")
        return self

    @model_validator(mode="after")
    def _one_focus_only(self) -> Self:
        if (self.focus is not None) + (self.lens_position_dpt is not None) + self.autofocus > 1:
            raise ValueError("focus, lens_position_dpt and autofocus exclude each other; write one of them")
        return self

    @model_validator(mode="after")
    def _one_white_balance_only(self) -> Self:
        if self.colour_gains is not None and self.white_balance != "auto":
            raise ValueError("white_balance and colour_gains exclude each other; write one of them")
        return self

    @model_validator(mode="after")
    def _exposure_fits_the_rate(self) -> Self:
        if self.rate and self.exposure and self.exposure * self.rate > 1:
            raise ValueError(
                f"an exposure of {1e3 * self.exposure:g} ms is longer than a frame at {self.rate:g} Hz;"
                f' write rate = "{math.floor(1 / self.exposure)} Hz" or less, or a shorter exposure'
            )
        return self

    @model_validator(mode="after")
    def _crop_is_an_area(self) -> Self:
        if self.crop_px is not None and not (min(self.crop_px[:2]) >= 0 and min(self.crop_px[2:]) > 0):
            raise ValueError(
                "crop_px is left, top, width and height in pixels of the sensor, such as [0, 0, 3280, 2464]"
            )
        return self

    @property
    def name(self) -> str:
        """The camera's name in messages."""
        return f"number {self.camera}" if isinstance(self.camera, int) else self.camera

    @property
    def sensor_size_px(self) -> tuple[int, int] | None:
        """The width and height of the sensor's mode; None where libcamera chooses."""
        if self.sensor_width_px is None or self.sensor_height_px is None:
            return None
        return self.sensor_width_px, self.sensor_height_px

    @property
    def frame_duration_s(self) -> float:
        """The time from one frame to the next."""
        return 1 / self.rate if self.rate else max(1 / RATE_HZ, self.exposure or 0.0)


def number_of(camera: int | str, attached: list[dict[str, Any]]) -> int:
    """Return the number of the camera that is meant.

    Args:
        attached: ``Picamera2.global_camera_info()``: of each camera, by its number, ``Model`` and ``Id``.

    Raises:
        DeviceOpenError: There is none, or there are several of that model.
    """
    if not attached:
        raise errors.DeviceOpenError(
            "libcamera finds no camera; is the ribbon cable in, the right way round, at both ends? Plug it in while the"
            " Pi has no power. `rpicam-hello --list-cameras` lists what is found"
        )
    numbers = [n for n, each in enumerate(attached) if camera in {n, each.get("Id"), each.get("Model")}]
    if len(numbers) == 1:
        return numbers[0]
    there = ", ".join(f"{n} ({each.get('Model', 'unknown')}, {each.get('Id', '')})" for n, each in enumerate(attached))
    what = "there are several cameras" if numbers else "there is no camera"
    raise errors.DeviceOpenError(f"{what} {camera!r} for camera in [camera]; there are: {there}")


def controls_of(options: Picamera2Settings, available: Controls, enums: Any) -> dict[str, Any]:
    """Return the controls to set before the camera starts, so that its first frame has them; those that it has.

    Args:
        enums: The module ``libcamera.controls``.
    """
    duration_us = round(1e6 * options.frame_duration_s)
    wanted: dict[str, Any] = {"FrameDurationLimits": (duration_us, duration_us)}
    if options.exposure is not None:
        wanted["ExposureTime"] = round(1e6 * options.exposure)
    if options.gain is not None:
        wanted["AnalogueGain"] = options.gain
    if options.exposure is not None and options.gain is not None:
        wanted["AeEnable"] = False  # with one of them, the automatic exposure goes on with the other
    if options.colour_gains is not None:
        wanted |= {"AwbEnable": False, "ColourGains": options.colour_gains}
    else:
        wanted |= {"AwbEnable": True, "AwbMode": getattr(enums.AwbModeEnum, options.white_balance.capitalize())}
    if options.autofocus:
        wanted["AfMode"] = enums.AfModeEnum.Continuous
    elif (position_dpt := lens_position_dpt(options, available)) is not None:
        wanted |= {"AfMode": enums.AfModeEnum.Manual, "LensPosition": position_dpt}
    return {name: value for name, value in wanted.items() if name in available}


def lens_position_dpt(options: Picamera2Settings, available: Controls) -> float | None:
    """Return where the lens stays; None for one that is turned by hand, or refocuses by itself.

    Without a setting it stays at the position that libcamera takes for the middle of what this lens is used for.
    """
    if options.autofocus or "LensPosition" not in available:
        return None
    if options.focus is not None:
        return 1 / options.focus
    if options.lens_position_dpt is not None:
        return options.lens_position_dpt
    return float(available["LensPosition"][2] or 0.0)


def not_there(options: Picamera2Settings, available: Controls) -> Iterator[str]:
    """Yield a sentence on each setting that the camera has no control for."""
    if "LensPosition" not in available and (options.focus is not None or options.lens_position_dpt is not None):
        yield "asked for a focus, this camera's lens has no motor: turn it by hand"
    if options.autofocus:
        yield (
            "the camera refocuses by itself (autofocus = true): its focal length changes, and every distance with it"
            if "AfMode" in available
            else "asked for autofocus, the camera has none"
        )
    for key, value, control in (
        ("an exposure time", options.exposure, "ExposureTime"),
        ("a gain", options.gain, "AnalogueGain"),
        ("fixed gains of colours", options.colour_gains, "ColourGains"),
        ("a crop", options.crop_px, "ScalerCrop"),
    ):
        if value is not None and control not in available:
            yield f"asked for {key}, the camera has no control for it"


def not_taken(options: Picamera2Settings, taken: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence on each part of the configuration that libcamera took otherwise."""
    size_px = tuple(taken["main"]["size"])
    if size_px != (options.width_px, options.height_px):
        asked = f"{options.width_px} × {options.height_px}"
        yield f"asked for pictures of {asked} pixels, the camera gives {size_px[0]} × {size_px[1]}"
    mode_px = tuple((taken.get("sensor") or {}).get("output_size") or ())
    if options.sensor_size_px and mode_px and mode_px != options.sensor_size_px:
        asked, nearest = ("{} × {}".format(*size_px) for size_px in (options.sensor_size_px, mode_px))
        yield f"asked for the sensor's mode of {asked} pixels, the nearest that it has is {nearest}"
    turned = taken["transform"]
    if bool(turned.hflip) != options.upside_down or bool(turned.vflip) != options.upside_down:
        yield "asked for pictures turned by half a turn, the camera does not turn them so"


def optics_of(
    options: Picamera2Settings,
    attached: Mapping[str, Any],
    configuration: Mapping[str, Any],
    set_to: Mapping[str, Any],
    found: Metadata,
) -> Optics | None:
    """Return the settings that change the focal length in pixels; None if the camera does not say its crop.

    The lens counts as standing where it was sent: it has no sensor of its own.

    Args:
        attached: What libcamera says of the camera.
        configuration: What it made of the configuration.
        found: What it says of a frame.
    """
    crop_px, mode_px = found.get("ScalerCrop"), (configuration.get("sensor") or {}).get("output_size")
    if crop_px is None or mode_px is None:
        return None
    left, top, width, height = map(int, crop_px)
    return Optics(
        sensor=str(attached.get("Model", "")),
        sensor_size_px=(int(mode_px[0]), int(mode_px[1])),
        crop_px=(left, top, width, height),
        lens_position_dpt=set_to.get("LensPosition"),
        upside_down=options.upside_down,
    )


def differences(options: Picamera2Settings, set_to: Mapping[str, Any], found: Metadata) -> Iterator[str]:
    """Yield a sentence on each control that a frame does not show as it was set.

    Sensors count exposures in lines and gains in steps, so some per cent are no difference.
    """
    duration_us = set_to.get("FrameDurationLimits", (None,))[0]
    if _is_off(duration_us, found.get("FrameDuration"), 0.01):
        yield f"asked for {1e6 / duration_us:.4g} frames a second, the camera gives {1e6 / found['FrameDuration']:.4g}"
    if _is_off(set_to.get("ExposureTime"), found.get("ExposureTime"), 0.02, 50):
        yield (
            f"asked for an exposure of {set_to['ExposureTime'] / 1e3:g} ms,"
            f" the camera takes {found['ExposureTime'] / 1e3:g} ms"
        )
    if _is_off(set_to.get("AnalogueGain"), found.get("AnalogueGain"), 0.05):
        yield f"asked for a gain of {set_to['AnalogueGain']:g}, the camera takes {found['AnalogueGain']:.3g}"
    gains = found.get("ColourGains", (None, None))
    if any(_is_off(want, has, 0.02) for want, has in zip(set_to.get("ColourGains", ()), gains, strict=False)):
        asked = ", ".join(f"{gain:g}" for gain in set_to["ColourGains"])
        yield f"asked for colour gains of {asked}, the camera takes {', '.join(f'{gain:.3g}' for gain in gains)}"
    if _is_off(set_to.get("LensPosition"), found.get("LensPosition"), 0.01, 0.02):
        yield (
            f"asked for a lens at {set_to['LensPosition']:.3g} dioptres, it stands at {found['LensPosition']:.3g}:"
            " distances will be off"
        )
    crop = found.get("ScalerCrop")
    if options.crop_px is not None and crop is not None and tuple(crop) != options.crop_px:
        yield f"asked for the crop {list(options.crop_px)}, the camera takes {list(crop)}"


def _is_off(wanted: float | None, found: float | None, share: float, least: float = 0.0) -> bool:
    """Check whether a value is known and off by more than a share of it."""
    return wanted is not None and found is not None and abs(found - wanted) > max(share * abs(wanted), least)


# A network on the sensor of a Raspberry Pi AI camera (IMX500): it finds boxes, which come with the frames ---

# The pixels of the whole sensor, which the network sees, and in which libcamera gives the crop.
SENSOR_PX = (4056.0, 3040.0)


class SensorNetwork:
    """A network on the sensor. Putting it there takes up to some minutes for the first time.

    Args:
        options: Of the camera; they name the network and the size of its pictures.

    Raises:
        DeviceOpenError: The package lacks what it takes, there is no such camera or file, or the picture is turned.
    """

    def __init__(self, options: Picamera2Settings) -> None:
        if options.upside_down:
            raise errors.DeviceOpenError("the network sees its picture unturned: leave out upside_down or network")
        try:
            from picamera2.devices import IMX500  # noqa: PLC0415 - only an AI camera needs it

            self._device = IMX500(str(options.network))
        except Exception as error:
            hint = "it is one of an AI camera's, *_pp.rpk from the package imx500-models"
            raise errors.DeviceOpenError(f"the network {options.network} cannot be used: {error}; {hint}") from error
        self._size_px = np.array((options.width_px, options.height_px))

    def find(self, metadata: Metadata) -> SensorBoxes | None:
        """Return the boxes it has found in a frame; None if it has not ended with one.

        Raises:
            LinkLostError: The network gives something else than boxes.
        """
        outputs = self._device.get_outputs(metadata)
        if outputs is None or "ScalerCrop" not in metadata:
            return None
        shapes = [each.shape for each in outputs]
        if len(outputs) < 3 or shapes[0] != (len(outputs[1]), 4) or len(shapes[1]) != 1 or shapes[2] != shapes[1]:
            words = f"the network on the sensor gives {shapes}, no boxes, scores and classes; name another"
            raise errors.LinkLostError(words)
        corners, says = np.asarray(outputs[0], np.float64).reshape(-1, 2, 2), self._device.network_intrinsics
        if says is not None and says.bbox_normalization:
            corners = corners / self._device.get_input_size()[1]
        if says is None or says.bbox_order != "xy":
            corners = corners[:, :, ::-1]
        # The whole sensor is 0 to 1; the crop of it fills the picture, whose first pixel has its centre at 0.
        crop = np.array(metadata["ScalerCrop"], np.float64)
        corners_px = (corners * SENSOR_PX - crop[:2]) / crop[2:] * self._size_px - 0.5
        names = dict(enumerate((says.labels if says is not None else None) or ()))
        classes = tuple(names.get(number, str(number)) for number in outputs[2].astype(int).tolist())
        input_px = float((crop[2:] / SENSOR_PX * self._device.get_input_size()).max())
        return SensorBoxes(corners_px.reshape(-1, 4), np.asarray(outputs[1], np.float64), classes, input_px)


# The camera: its package, its options and its frames ------------------------------------------------------------------

DEVICES = ("/dev/media*", "/dev/video*")


class Package(Struct, frozen=True, kw_only=True):
    """The parts of the packages picamera2 and libcamera that are used."""

    Picamera2: Any  # the class of cameras
    MappedArray: Any  # shows the buffer of a request as an array, without a copy
    Transform: Any  # how pictures are turned
    controls: Any  # the enumerations of control values


def load_package() -> Package:
    """Import picamera2, which takes a second; raises `DriverUnavailableError` where it is not there or does not fit."""
    # Both write to the terminal what they do and what went wrong, which our errors say, unless this says otherwise.
    os.environ.setdefault("LIBCAMERA_LOG_LEVELS", "*:ERROR")
    logging.getLogger("picamera2").addHandler(logging.NullHandler())
    try:
        import libcamera  # noqa: PLC0415 - only a Raspberry Pi has it
        import picamera2  # noqa: PLC0415
    except ImportError as error:
        raise errors.DriverUnavailableError(lack() or f"picamera2 cannot be loaded: {error}") from error
    except Exception as error:  # a package that was built for another numpy fails with a ValueError
        mend = f"where the system's packages are for numpy 1, run `pip install {extras.NUMPY_1}`"
        remedy = extras.PACKAGE_AGAIN if sys.prefix.startswith(extras.PACKAGED) else mend
        raise errors.DriverUnavailableError(f"picamera2 does not fit this environment: {error}; {remedy}") from error
    if not hasattr(picamera2.Picamera2, "cancel_all_and_flush"):
        raise errors.DriverUnavailableError(extras.PICAMERA2_TOO_OLD)
    return Package(
        Picamera2=picamera2.Picamera2,
        MappedArray=picamera2.MappedArray,
        Transform=libcamera.Transform,
        controls=libcamera.controls,
    )


def lack() -> str:
    """Return why picamera2 cannot be loaded here, in a sentence, or an empty string; loads nothing."""
    seen = "the library picamera2 is not installed"
    if find_spec("picamera2") is not None:
        if find_spec("libcamera") is not None:
            return extras.PICAMERA2_TOO_OLD if _is_too_old() else ""
        seen = "picamera2 is there without libcamera, which pip does not have"
    elif (extras.SYSTEM_PACKAGES / "picamera2").is_dir():
        seen = "picamera2 is installed, but not seen from this Python environment"
    return f"{seen}: `{extras.of_system('python3-picamera2')}`"


def _is_too_old() -> bool:
    try:
        numbers = re.findall(r"\d+", version("picamera2"))
    except PackageNotFoundError:  # loading it will show
        return False
    return [int(each) for each in numbers[:3]] < [int(each) for each in extras.OLDEST_PICAMERA2.split(".")]


def why(error: BaseException) -> str:
    """Explain what happened, in one line. Picamera2 hides the cause behind one sentence for everything."""
    root: BaseException = error
    while (before := root.__cause__ or root.__context__) and not isinstance(before, errors.StadimeterError):
        root = before
    words = " ".join(str(root).split()) or type(root).__name__
    if "busy" in words.lower() or "acquire" in words.lower():
        return f"{in_use(*DEVICES)} (libcamera says: {words})"
    return words


# libcamera names a format by its bytes in a little-endian word: in memory blue comes first, as OpenCV has it.
PICTURE_FORMAT = "RGB888"

# Buffers that libcamera fills in turn. One is held while a frame is copied, two are needed for full rate.
BUFFERS = 4

# A frame that arrives later than this many frame durations, and this, after its read-out began has waited: reading out
# takes up to one frame, the image processor up to another, and a busy computer a little.
LATE_FRAMES = 2.0
LATE_S = 0.05

# A frame arrives this many frame durations after its read-out began: one to be read out, and a part of another in the
# image processor. The stamps of a run say exactly how long; this is for `check`.
WAY_FRAMES = 1.5

# Time limit for the first frames, beside the time that they last.
FIRST_FRAME_S = 3.0
# Frames in which a control must show its effect: sensors take two, lenses some.
SETTLING_FRAMES = 10


class Picamera2Options(Picamera2Settings):
    """The options of a Raspberry Pi's own camera, on the ribbon cable."""

    def build(self, context: DriverContext) -> Picamera2Camera:
        """Return the camera."""
        return Picamera2Camera(self, context.clock)

    @staticmethod
    def attached() -> tuple[AttachedCamera, ...]:
        """Return the cameras on ribbon cables; none without the packages. USB cameras are left to ``opencv``."""
        try:
            every = load_package().Picamera2.global_camera_info()
        except errors.DriverUnavailableError:
            return ()
        found = [
            (str(each.get("Id", number)), str(each.get("Model", "unknown")), f"camera {number}")
            for number, each in enumerate(every)
            if "usb" not in each.get("Id", "").lower()
        ]
        return tuple(
            AttachedCamera(driver="picamera2", options={"camera": path}, path=path, name=name, node=node)
            for path, name, node in found
        )

    def lacks(self) -> tuple[str, ...]:
        """Return why picamera2 cannot be loaded here."""
        return tuple(filter(None, (lack(),)))

    def frame_latency_s(self) -> float:
        """Return about how old a frame is when it arrives: its exposure, its read-out and the image processor."""
        return (self.exposure or self.frame_duration_s / 2) + WAY_FRAMES * self.frame_duration_s


class Picamera2Camera(LiveCamera):
    """A camera of a Raspberry Pi.

    A frame's capture time is when the exposure of its first row began: libcamera's ``SensorTimestamp``, at which that
    row was read out, less the exposure time. That stamp is the kernel's and on ``CLOCK_MONOTONIC``, though libcamera's
    documentation says ``CLOCK_BOOTTIME``; the two differ only after a suspend, which a Pi does not have, and a stamp of
    the future is not believed. Frames without a stamp that is believed, and those that have waited, are passed over.

    Every setting is given before it starts, each time that it is opened. What frames then show otherwise is a remark.

    Picamera2 hangs where its camera does: a request that does not come keeps later ones waiting, and a close never
    ends. So late requests are cancelled, and a thread of its own closes the camera; while that hangs, none can open it.

    Args:
        load, monotonic: Imports the vendor's packages, and the clock of the stamps; others are for tests.
    """

    def __init__(
        self,
        options: Picamera2Options,
        clock: Clock,
        load: Callable[[], Package] = load_package,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(options.name)
        self._options = options
        self._clock = clock
        self._load = load
        self._package: Package | None = None
        self._device: Any = None
        self._closer: threading.Thread | None = None
        self._network: SensorNetwork | None = None
        self._kernel_time = KernelTime(monotonic)
        self._last_captured_s = -math.inf

    def _break_off(self) -> None:
        if (device := self._device) is not None:
            device.cancel_all_and_flush()

    def _release(self) -> None:
        device, self._device = self._device, None
        if device is None:
            return
        self._closer = threading.Thread(target=_close, args=(device,), name="closing the camera", daemon=True)
        self._closer.start()
        self._closer.join(CLOSE_WAIT_S)

    def _acquire(self) -> tuple[str, ...]:
        if self._closer is not None and self._closer.is_alive():
            raise errors.DeviceHungError(
                f"the camera {self._name} is still being closed: libcamera hangs; check its cable, with the Pi switched"
                " off"
            )
        self._package = self._package or self._load()
        return self._started(self._package)

    def _started(self, package: Package) -> tuple[str, ...]:
        """Open the camera, set it up and start it; return a sentence on each setting that it did not take."""
        options = self._options
        try:
            attached = package.Picamera2.global_camera_info()
            number = number_of(options.camera, attached)
            self._network = SensorNetwork(options) if options.network else None  # before the camera is opened
            device = self._device = _acquired(package.Picamera2, number)
            available = device.camera_controls
            set_to = controls_of(options, available, package.controls)
            self._configure(package, device, set_to)
            device.start()
        except errors.DriverError:
            raise
        except Exception as error:
            raise errors.DeviceOpenError(f"the camera {self._name} cannot be opened: {why(error)}") from error
        found, taken = self._settled(set_to), device.camera_configuration()
        self._optics = optics_of(options, attached[number], taken, set_to, found)
        return (*not_there(options, available), *not_taken(options, taken), *differences(options, set_to, found))

    def _configure(self, package: Package, device: Any, set_to: dict[str, Any]) -> None:
        options = self._options
        device.configure(
            device.create_video_configuration(
                main={"size": (options.width_px, options.height_px), "format": PICTURE_FORMAT},
                raw=None,
                sensor={"output_size": options.sensor_size_px} if options.sensor_size_px else {},
                transform=package.Transform(hflip=options.upside_down, vflip=options.upside_down),
                buffer_count=BUFFERS,
                queue=False,  # else the frame from before the call is given, however old
                display=None,
                encode=None,
                controls=set_to,
            )
        )
        found = device.camera_configuration()["main"]["format"]
        if found != PICTURE_FORMAT:
            raise errors.DeviceOpenError(
                f"the camera {options.name} gives {found} instead of colour pictures; for a USB camera use the driver"
                " 'opencv'"
            )
        if options.crop_px is not None:
            # A Pi 5 has a crop for each of its streams, which Picamera2 sets itself and which overrides the other.
            crops = {"ScalerCrops": [options.crop_px], "ScalerCrop": options.crop_px}
            name = next((name for name in crops if name in device.camera_controls), None)
            if name is not None:
                device.set_controls({name: crops[name]})

    def _settled(self, set_to: dict[str, Any]) -> Metadata:
        """Wait until the settings have taken effect; return what the last frame shows."""
        name = self._options.name
        until_s = self._clock.now_s() + FIRST_FRAME_S + SETTLING_FRAMES * self._options.frame_duration_s
        found: Metadata = {}
        try:
            for _ in range(SETTLING_FRAMES):
                with self._request(until_s - self._clock.now_s()) as request:
                    found = request.get_metadata()
                if not any(differences(self._options, set_to, found)):
                    break
        except (errors.CaptureTimeoutError, errors.LinkLostError) as error:
            if not found:
                words = "opens but gives no picture; check both ends of its cable, with the Pi switched off"
                raise errors.DeviceOpenError(f"the camera {name} {words}") from error
        if self._captured_at_s(found) is None:
            words = "does not say when it took its pictures; for a USB camera use the driver 'opencv'"
            raise errors.DeviceOpenError(f"the camera {name} {words}")
        return found

    def _next(self) -> CapturedPicture:
        """Wait for a frame that did not wait itself.

        A late one is passed over if there is time for another, and no oftener than there are buffers: after as many, a
        frame cannot be from before the call.
        """
        until_s, passed_over = self._clock.now_s() + self._options.read_timeout, 0
        while (left_s := until_s - self._clock.now_s()) > 0:
            with self._request(left_s) as request:
                metadata = request.get_metadata()
                captured_at_s = self._captured_at_s(metadata)
                may_pass_over = passed_over < BUFFERS and self._clock.now_s() < until_s
                if captured_at_s is not None and not (may_pass_over and self._is_late(metadata)):
                    self._last_captured_s = captured_at_s
                    boxes = self._network.find(metadata) if self._network else None
                    return CapturedPicture(self._copied(request), captured_at_s, _exposure_s(metadata), boxes)
            passed_over += 1
        raise errors.CaptureTimeoutError(
            f"the camera {self._options.name} gave no new frame for {self._options.read_timeout:g} s"
            + (f" ({passed_over} that were late or of unknown age)" if passed_over else "")
        )

    def _copied(self, request: Any) -> Image:
        """Return a request's picture without the padding of its rows: the one copy that is made of it."""
        if self._package is None:
            raise self._not_open()
        with self._package.MappedArray(request, "main") as mapped:
            return np.array(mapped.array, np.uint8, order="C")

    @contextmanager
    def _request(self, limit_s: float) -> Iterator[Any]:
        """Wait for the next request that libcamera completes; give it back afterwards."""
        name, device = self._options.name, self._device
        try:
            request = device.wait(device.capture_request(wait=False), timeout=max(0.0, limit_s))
        except TimeoutError as error:
            device.cancel_all_and_flush()  # else every later request waits behind this one
            raise errors.CaptureTimeoutError(
                f"the camera {name} gave no frame for {limit_s:.1f} s; is its cable loose?"
            ) from error
        except CancelledError as error:
            raise errors.DeviceClosedError(f"the camera {name} was closed while a frame was awaited") from error
        except Exception as error:
            raise errors.LinkLostError(f"the camera {name} has failed: {why(error)}") from error
        try:
            self._check_open()
            yield request
        finally:
            with suppress(Exception):  # it was closed meanwhile
                request.release()

    def _captured_at_s(self, metadata: Metadata) -> float | None:
        """Return when the exposure of a frame began, on the run's clock, not before the last one; None if unknown."""
        began_at_s = self._read_out_at_s(metadata) - (_exposure_s(metadata) or 0.0)
        return max(self._last_captured_s, began_at_s) if began_at_s <= self._clock.now_s() else None

    def _is_late(self, metadata: Metadata) -> bool:
        duration_s: float = metadata.get("FrameDuration", 1e6 * self._options.frame_duration_s) / 1e6
        return self._clock.now_s() > self._read_out_at_s(metadata) + LATE_FRAMES * duration_s + LATE_S

    def _read_out_at_s(self, metadata: Metadata) -> float:
        """Return when the read-out of a frame began, on the run's clock; infinite if that is not known."""
        stamp_s: float = metadata.get("SensorTimestamp", 0) / 1e9
        return self._kernel_time.on_run_clock(stamp_s, self._clock.now_s()) if stamp_s > 0 else math.inf


def _exposure_s(metadata: Metadata) -> float | None:
    exposure_us: float | None = metadata.get("ExposureTime")
    return exposure_us / 1e6 if exposure_us else None


def _acquired(kind: Any, number: int) -> Any:
    """Return an open camera; one that cannot be opened leaves no descriptor behind.

    The constructor of picamera2 makes a pipe before anything else, and only closing an open camera closes its writing
    end: without this, a run that waits for a busy camera would have no descriptors left after some hours.
    """
    device = kind.__new__(kind)
    try:
        device.__init__(number)
    except BaseException:
        if getattr(device, "is_open", False):  # it failed later
            _close(device)
        else:
            with suppress(AttributeError, OSError):
                os.close(device.notifyme_w)
        raise
    return device


def _close(device: Any) -> None:
    with suppress(Exception):  # a camera that was lost cannot be stopped, and there is nothing to be done about it
        device.close()
