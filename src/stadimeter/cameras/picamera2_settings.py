"""The controls that the options of a Raspberry Pi's own camera become, and what the camera did not take."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from stadimeter.config.plugins import DriverOptions
from stadimeter.config.units import Duration, FilePath, Frequency, Length
from stadimeter.core.frame import Optics
from stadimeter.errors import DeviceOpenError

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
        raise DeviceOpenError(
            "libcamera finds no camera; is the ribbon cable in, the right way round, at both ends? Plug it in while the"
            " Pi has no power. `rpicam-hello --list-cameras` lists what is found"
        )
    numbers = [n for n, each in enumerate(attached) if camera in {n, each.get("Id"), each.get("Model")}]
    if len(numbers) == 1:
        return numbers[0]
    there = ", ".join(f"{n} ({each.get('Model', 'unknown')}, {each.get('Id', '')})" for n, each in enumerate(attached))
    what = "there are several cameras" if numbers else "there is no camera"
    raise DeviceOpenError(f"{what} {camera!r} for camera in [camera]; there are: {there}")


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
