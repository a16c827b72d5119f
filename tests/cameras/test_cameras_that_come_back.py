"""Cameras that hang or vanish, and come back with other settings: how soon they are used, and how they are set then."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from msgspec import Struct

from stadimeter.app.capture import CaptureThread, FreezeDetector
from stadimeter.cameras.live_camera import LiveCamera
from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from stadimeter.cameras.picamera2_camera import Picamera2Camera, Picamera2Options
from stadimeter.core.frame import Frame
from stadimeter.testing.rig import ManualClock
from support.picamera2_double import Sensor

if TYPE_CHECKING:
    from conftest import FakeDevice

BACK_WITHIN_S = 5.0
OPENS_IN_S = 1.5
"""USB cameras take about a second to open, and so does libcamera."""

OUTAGES_S = (0.04, 0.6, 1.7, 3.3, 9.0, 61.0)


class Rig(Struct):
    """A camera, and what happens to it.

    Attributes:
        lose: Pulls it out.
        hang: Lets it fall silent.
        give_back: Makes it work again; what it was set to is gone if it had no power.
        settings: Returns how it is set now.
    """

    clock: ManualClock
    camera: LiveCamera
    lose: Callable[[], None]
    hang: Callable[[], None]
    give_back: Callable[[], None]
    settings: Callable[[], object]

    def thread(self) -> CaptureThread:
        """Return what reads it in a run, to be stepped here."""

        def wait(_stopped: threading.Event, delay_s: float) -> bool:
            self.clock.advance_s(delay_s)
            return False

        return CaptureThread(self.camera, self.clock, FreezeDetector(), wait)


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(1000.0)


def ribbon_camera(clock: ManualClock, _device: FakeDevice, _folder: Path) -> Rig:
    sensor = Sensor(clock, opens_in_s=OPENS_IN_S)
    table = {"width_px": 64, "height_px": 48, "exposure": "5 ms", "gain": 4, "focus": "2 m", "crop_px": [0, 0, 64, 36]}
    options = Picamera2Options.model_validate(table)

    def lose() -> None:
        sensor.is_there, sensor.is_silent = False, True

    def give_back() -> None:
        sensor.is_there, sensor.is_silent = True, False

    return Rig(
        clock,
        Picamera2Camera(options, clock, sensor.package, monotonic=clock.now_s),
        lose=lose,
        hang=lambda: setattr(sensor, "is_silent", True),
        give_back=give_back,
        settings=lambda: dict(sensor.cameras[0]._settings),
    )


def usb_camera(clock: ManualClock, device: FakeDevice, folder: Path) -> Rig:
    node = folder / "video0"
    node.touch()
    random_numbers = np.random.default_rng(1)
    is_silent = False

    def wait() -> None:
        clock.advance_s(1.0 if is_silent else 1 / 30)
        device.images = [random_numbers.integers(0, 255, (480, 640, 3), dtype=np.uint8)]

    def set_silent(*, to: bool) -> None:
        nonlocal is_silent
        is_silent = to
        device.is_connected = not to

    def lose() -> None:
        device.is_connected = False
        node.unlink()

    def give_back() -> None:
        set_silent(to=False)
        if not node.exists():
            node.touch()
            device.values = {cv2.CAP_PROP_EXPOSURE: 300.0, cv2.CAP_PROP_AUTOFOCUS: 1.0, cv2.CAP_PROP_FPS: 15.0}

    def opened(*source: object) -> FakeDevice:
        clock.advance_s(OPENS_IN_S)
        device(*source)
        device.is_connected = device.is_connected or is_silent  # a camera that is silent still opens
        return device

    device.wait = wait
    options = OpenCvOptions.model_validate({"device": str(node), "exposure": "5 ms", "rate": "30 Hz"})
    return Rig(
        clock,
        OpenCvCamera(options, clock, opened, monotonic=clock.now_s),
        lose=lose,
        hang=lambda: set_silent(to=True),
        give_back=give_back,
        settings=lambda: dict(device.values),
    )


@pytest.mark.parametrize("outage_s", OUTAGES_S)
@pytest.mark.parametrize("fault", ["lose", "hang"])
@pytest.mark.parametrize("make", [ribbon_camera, usb_camera])
def test_a_camera_is_used_within_five_seconds_of_being_back_and_set_as_configured(
    clock: ManualClock, device: FakeDevice, tmp_path: Path, make: Callable[..., Rig], fault: str, outage_s: float
) -> None:
    rig = make(clock, device, tmp_path)
    rig.camera.open()
    thread = rig.thread()
    first, settings = _next_frame(thread), rig.settings()
    getattr(rig, fault)()
    back_at_s = clock.now_s() + outage_s
    cancel = clock.call_every(0.01, lambda now_s: _once(cancel, rig.give_back) if now_s >= back_at_s else None)
    frame = _next_frame(thread)
    while frame.captured_at_s < back_at_s:
        frame = _next_frame(thread)
    assert clock.now_s() - back_at_s <= BACK_WITHIN_S
    assert frame.captured_at_s > first.captured_at_s
    assert rig.settings() == settings
    assert rig.camera.remarks == ()
    assert thread.trouble() == thread.hung() == ""


def _next_frame(thread: CaptureThread) -> Frame:
    while True:
        thread._read_once()
        if (frame := thread.mailbox.take(0.0)) is not None:
            return frame


def _once(cancel: Callable[[], None], do: Callable[[], None]) -> None:
    cancel()
    do()
