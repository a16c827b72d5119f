"""A double of the packages picamera2 and libcamera, as they behave at the edge that the driver touches.

What it imitates, of picamera2 0.3.19 to 0.3.36: a sensor that fills a few buffers in turn, and pauses while all are
held; requests that complete a while after their exposure; jobs that wait for requests, in order, so that one that
never ends keeps the later ones waiting; rows that are padded; controls that may be set only if there are any, and that
show their effect some frames later; a constructor that hides every cause behind one sentence, and makes a pipe first,
which only an open camera closes; a camera that falls silent when its cable is loose, and then cannot be closed.
"""

from __future__ import annotations

import enum
import io
import mmap
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from importlib.machinery import ModuleSpec
from types import ModuleType, SimpleNamespace
from typing import Any, Self

import numpy as np
import pytest
from msgspec import Struct, field

from stadimeter.cameras.picamera2_camera import Package
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image

ROW_ALIGNMENT = 64
FULL_PX = (4608, 2592)
MODES_PX = ((1536, 864), (2304, 1296), (4608, 2592))
POLL_S = 0.005


class AfMode(enum.IntEnum):
    Manual = 0
    Auto = 1
    Continuous = 2


class AwbMode(enum.IntEnum):
    Auto = 0
    Incandescent = 1
    Tungsten = 2
    Fluorescent = 3
    Indoor = 4
    Daylight = 5
    Cloudy = 6


class Transform(Struct, frozen=True):
    hflip: bool = False
    vflip: bool = False


class Sensor(Struct):
    """The camera on the cable, whatever program has opened it.

    Attributes:
        way_s: How long a frame takes from the beginning of its read-out to its completion.
        settings: What it uses: the last settings that were given, or its own.
        keeps: Settings that it does not let be changed.
        acts_after: In how many frames a setting shows its effect.
        lacks: Controls that it does not have.
        picture: What it sees, which gets some noise; None for `frame_image`.
        waiting_s: The ages of frames that have waited in the queue from before.
        is_silent: It completes no more frames.
        let_go: Closing ends only when this is set.
        opens_in_s: How long opening takes.
    """

    clock: Clock
    model: str = "imx708"
    path: str = "/base/axi/pcie@1000120000/rp1/i2c@88000/imx708@1a"
    way_s: float = 0.045
    settings: dict[str, Any] = field(default_factory=dict)
    keeps: dict[str, Any] = field(default_factory=dict)
    acts_after: int = 0
    lacks: set[str] = field(default_factory=set)
    waiting_s: list[float] = field(default_factory=list)
    format: str = "RGB888"
    picture: Image | None = None
    is_silent: bool = False
    is_there: bool = True
    is_stamped: bool = True
    turns: bool = True
    let_go: threading.Event = field(default_factory=threading.Event)
    opens_in_s: float = 0.0
    cameras: list[Camera] = field(default_factory=list)
    configurations: list[dict[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.let_go.set()

    @property
    def held(self) -> int:
        return len(self.cameras)

    def image(self, number: int, width_px: int, height_px: int) -> Image:
        if self.picture is None:
            return frame_image(number, width_px, height_px)
        noise = np.random.default_rng(number).integers(0, 3, self.picture.shape, dtype=np.uint8)
        return np.asarray(np.maximum(self.picture, 2) - noise, np.uint8)

    def acquire(self) -> None:
        if self.cameras:
            raise RuntimeError("Failed to acquire camera: Device or resource busy")
        self.clock.sleep_until_s(self.clock.now_s() + self.opens_in_s)

    def package(self) -> Package:
        """Return what the driver imports."""
        return Package(
            Picamera2=_class_of(self),
            MappedArray=MappedArray,
            Transform=Transform,
            controls=SimpleNamespace(AfModeEnum=AfMode, AwbModeEnum=AwbMode),
        )


def _class_of(sensor: Sensor) -> type[Camera]:
    class Picamera2(Camera):
        def __init__(self, camera_num: int = 0) -> None:
            super().__init__(sensor, camera_num)

        @staticmethod
        def global_camera_info() -> list[dict[str, Any]]:
            usb = {"Model": "C270", "Id": "\\_SB_.PCI0.USB-1:1.0-046d:0825", "Num": 1}
            return [{"Model": sensor.model, "Id": sensor.path, "Num": 0}, usb] if sensor.is_there else []

    return Picamera2


class ReadingEnd(io.FileIO):
    """The end of a pipe that a camera reads: a file, which closes itself when nothing refers to it any more."""

    def __del__(self) -> None:
        self.close()


class Camera:
    """An open camera: ``Picamera2``."""

    def __init__(self, sensor: Sensor, camera_num: int) -> None:
        self._sensor = sensor
        self._jobs: list[Future[Request]] = []
        self._lock = threading.Lock()
        self._configuration: dict[str, Any] = {}
        self._settings: dict[str, Any] = {}
        self._buffers: list[mmap.mmap] = []
        self._free: list[mmap.mmap] = []
        self._started_at_s: float | None = None
        self._frames = 0
        self.is_open = False
        reading, self.notifyme_w = os.pipe2(os.O_NONBLOCK)
        self.notifymeread = ReadingEnd(reading)
        self.global_camera_info()[camera_num]
        try:
            sensor.acquire()
        except RuntimeError:
            raise RuntimeError("Camera __init__ sequence did not complete.")  # noqa: B904 - as picamera2 does it
        sensor.cameras.append(self)
        self.is_open = True

    @staticmethod
    def global_camera_info() -> list[dict[str, Any]]:
        raise NotImplementedError

    @property
    def camera_controls(self) -> dict[str, tuple[Any, Any, Any]]:
        controls = {
            "AeEnable": (False, True, True),
            "AfMode": (0, 2, 0),
            "AnalogueGain": (1.12, 16.0, 1.0),
            "AwbEnable": (False, True, None),
            "AwbMode": (0, 7, 0),
            "ColourGains": (0.0, 32.0, None),
            "ExposureTime": (1, 66666, 20000),
            "FrameDurationLimits": (8333, 120000, 33333),
            "LensPosition": (0.0, 32.0, 1.0),
            "ScalerCrop": ((0, 0, 128, 128), (0, 0, *FULL_PX), (0, 0, *FULL_PX)),
        }
        return {name: limits for name, limits in controls.items() if name not in self._sensor.lacks}

    def create_video_configuration(self, **parts: Any) -> dict[str, Any]:
        known = {"main", "raw", "sensor", "transform", "buffer_count", "queue", "display", "encode", "controls"}
        assert set(parts) <= known, f"create_video_configuration() has no {set(parts) - known}"
        assert set(parts["main"]) <= {"format", "size", "stride", "preserve_ar"}
        assert set(parts["sensor"]) <= {"output_size", "bit_depth"}
        return parts

    def configure(self, configuration: dict[str, Any]) -> None:
        sensor = self._sensor
        self.set_controls(configuration["controls"])
        width_px, height_px = configuration["main"]["size"]
        asked = configuration["sensor"].get("output_size", (width_px, height_px))
        mode = min(MODES_PX, key=lambda mode: abs(mode[0] - asked[0]) + abs(mode[1] - asked[1]))
        stride = -(-3 * width_px // ROW_ALIGNMENT) * ROW_ALIGNMENT
        self._configuration = {
            **configuration,
            "main": {**configuration["main"], "format": sensor.format, "stride": stride},
            "sensor": {"output_size": mode, "bit_depth": 10},
            "transform": configuration["transform"] if sensor.turns else Transform(),
        }
        self._buffers = [mmap.mmap(-1, stride * height_px) for _ in range(configuration["buffer_count"])]
        self._free = list(self._buffers)
        sensor.configurations.append(configuration)

    def camera_configuration(self) -> dict[str, Any]:
        return self._configuration

    def set_controls(self, controls: dict[str, Any]) -> None:
        for name in controls:
            if name not in self.camera_controls:
                raise RuntimeError(f"Control {name} is not advertised by libcamera")
        self._settings |= controls

    def start(self) -> None:
        self._started_at_s = self._sensor.clock.now_s()
        self._frames = 0

    def capture_request(self, wait: bool | None = None) -> Future[Request]:
        assert wait is False, "waiting without a limit never ends when a camera hangs"
        job: Future[Request] = Future()
        with self._lock:
            self._complete()
            self._jobs.append(job)
            if self._sensor.waiting_s and self._free:
                stamp_s = self._sensor.clock.now_s() - self._sensor.waiting_s.pop(0)
                self._jobs.pop(0).set_result(self._request(stamp_s))
        return job

    def wait(self, job: Future[Request], timeout: float | None = None) -> Request:
        assert timeout is not None
        clock = self._sensor.clock
        until_s = clock.now_s() + timeout
        while not job.done():
            if clock.now_s() >= until_s:
                raise TimeoutError
            clock.sleep_until_s(min(until_s, clock.now_s() + POLL_S))
            with self._lock:
                self._complete()
        return job.result()

    def cancel_all_and_flush(self) -> None:
        with self._lock:
            for job in self._jobs:
                job.set_exception(CancelledError())
            self._jobs = []

    def close(self) -> None:
        if self.is_open:
            self._sensor.let_go.wait()
            self._sensor.cameras.remove(self)
            self.is_open = False
            for buffer in self._buffers:
                buffer.close()  # fails if an array still shows it
            self.notifymeread.close()
            os.close(self.notifyme_w)

    def _complete(self) -> None:
        """Give each frame that was completed since to the first job; without one it is dropped."""
        if self._started_at_s is None:
            return
        ended_s = self._sensor.clock.now_s() - self._sensor.way_s
        while (began_s := self._started_at_s + self._duration_s() * (self._frames + 1)) <= ended_s:
            self._frames += 1
            if self._jobs and self._free and not self._sensor.is_silent:
                self._jobs.pop(0).set_result(self._request(began_s))

    def _duration_s(self) -> float:
        return float(self._shown()["FrameDurationLimits"][0] / 1e6)

    def _shown(self) -> dict[str, Any]:
        own = {"FrameDurationLimits": (33333, 33333), "ExposureTime": 9990, "AnalogueGain": 2.0, "LensPosition": 0.0}
        crop = {"ScalerCrop": (0, 0, *FULL_PX), "ColourGains": (1.8, 1.6)}
        given = self._settings if self._frames > self._sensor.acts_after or not self._frames else {}
        rate = {"FrameDurationLimits": self._settings.get("FrameDurationLimits", (33333, 33333))}
        return {**own, **crop, **given, **rate, **self._sensor.keeps}

    def _request(self, began_s: float) -> Request:
        buffer, shown = self._free.pop(0), self._shown()
        metadata = {name: shown[name] for name in ("ExposureTime", "AnalogueGain", "ColourGains", "ScalerCrop")}
        metadata["FrameDuration"] = shown["FrameDurationLimits"][0]
        if "LensPosition" not in self._sensor.lacks:
            metadata["LensPosition"] = shown["LensPosition"]
        if self._sensor.is_stamped:
            metadata["SensorTimestamp"] = round(1e9 * began_s)
        main = self._configuration["main"]
        (width_px, height_px), stride = main["size"], main["stride"]
        rows = np.frombuffer(buffer, np.uint8).reshape(height_px, stride)
        rows[:] = 255  # what stands in the padding
        image = self._sensor.image(self._frames, width_px, height_px)
        rows[:, : 3 * width_px] = image.reshape(height_px, -1)
        return Request(metadata, {"main": main}, buffer, self._free.append)


def install(sensor: Sensor, monkeypatch: pytest.MonkeyPatch, **parts: Any) -> None:
    """Put modules in place of picamera2 and libcamera, as Python imports them."""
    package = sensor.package()
    contents = {
        "picamera2": {"Picamera2": package.Picamera2, "MappedArray": package.MappedArray, **parts},
        "libcamera": {"Transform": package.Transform, "controls": package.controls},
    }
    for name, attributes in contents.items():
        module = ModuleType(name)
        module.__spec__ = ModuleSpec(name, None)
        vars(module).update(attributes)
        monkeypatch.setitem(sys.modules, name, module)


def frame_image(number: int, width_px: int, height_px: int) -> Image:
    """Return what the sensor sees in its frame of that number: blue counts, green falls, red is from left to right."""
    image = np.empty((height_px, width_px, 3), np.uint8)
    image[..., 0], image[..., 1] = number % 250, 249 - number % 250
    image[..., 2] = np.linspace(0, 250, width_px).astype(np.uint8)
    return image


class Request(Struct):
    """A completed request: a buffer that the sensor does not fill before it is released."""

    metadata: dict[str, Any]
    config: dict[str, Any]
    buffer: mmap.mmap | None
    give_back: Callable[[mmap.mmap], None]

    def get_metadata(self) -> dict[str, Any]:
        return dict(self.metadata)

    def release(self) -> None:
        assert self.buffer is not None, "released twice"
        self.give_back(self.buffer)
        self.buffer = None


class MappedArray:
    """Shows the buffer of a request for as long as the context lasts."""

    def __init__(self, request: Request, stream: str) -> None:
        self._request, self._stream = request, stream
        self.array: Image | None = None

    def __enter__(self) -> Self:
        config = self._request.config[self._stream]
        (width_px, height_px), stride = config["size"], config["stride"]
        rows = np.array(self._request.buffer, copy=False, dtype=np.uint8).reshape(height_px, stride)
        self.array = rows[:, : 3 * width_px].reshape(height_px, width_px, 3)
        return self

    def __exit__(self, *_: object) -> None:
        self.array = None
