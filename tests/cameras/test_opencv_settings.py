"""Cameras on this computer: which there are, how they are set, and how they come back."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from msgspec import Struct

from stadimeter.app.capture import CaptureThread, FreezeDetector
from stadimeter.cameras import v4l2
from stadimeter.cameras.live_camera import LiveCamera
from stadimeter.cameras.opencv_device import FFMPEG_OPTIONS, OpenCvCamera, OpenCvOptions, apply_settings, size_differs
from stadimeter.cameras.picamera2_camera import Picamera2Camera, Picamera2Options
from stadimeter.cameras.protocol import CameraMode
from stadimeter.cameras.v4l2 import attached_devices
from stadimeter.core.frame import Frame
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case
from support.picamera2_double import Sensor
from support.v4l2_double import CAPTURE, METADATA, Kernel, Node

if TYPE_CHECKING:
    from conftest import FakeDevice

EVERYTHING = {
    "device": 0, "width_px": 1280, "height_px": 720, "rate": "30 Hz", "exposure": "5 ms", "autofocus": False,
}  # fmt: skip


def options(**table: Any) -> OpenCvOptions:
    return OpenCvOptions.model_validate({"device": 0, **table})


def test_settings_are_applied_in_the_order_that_drivers_need(device: FakeDevice) -> None:
    assert apply_settings(device, options(**EVERYTHING)) == ()
    assert device.calls == [
        (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG")),
        (cv2.CAP_PROP_FRAME_WIDTH, 1280),
        (cv2.CAP_PROP_FRAME_HEIGHT, 720),
        (cv2.CAP_PROP_FPS, 30),
        (cv2.CAP_PROP_AUTO_EXPOSURE, 1),
        (cv2.CAP_PROP_EXPOSURE, 50),
        (cv2.CAP_PROP_AUTOFOCUS, 0),
    ]


def test_without_wishes_only_format_exposure_and_focus_are_set(device: FakeDevice) -> None:
    assert apply_settings(device, options()) == ()
    assert [prop for prop, _ in device.calls] == [
        cv2.CAP_PROP_FOURCC, cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_AUTOFOCUS,
    ]  # fmt: skip
    assert device.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 3


@pytest.mark.parametrize(
    ("prop", "found", "table", "sentence"),
    [
        (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV"), {}, "pixel format MJPG, the camera gives YUYV"),
        (cv2.CAP_PROP_FOURCC, -1.0, {}, "pixel format MJPG, the camera gives another"),
        (cv2.CAP_PROP_FPS, 15.0, {"rate": "30 Hz"}, "asked for 30 frames a second, the camera says 15"),
        (cv2.CAP_PROP_AUTO_EXPOSURE, 1.0, {}, "asked for automatic exposure"),
        (cv2.CAP_PROP_AUTO_EXPOSURE, 3.0, {"exposure": "5 ms"}, "asked for manual exposure"),
        (cv2.CAP_PROP_EXPOSURE, 156.0, {"exposure": "5 ms"}, "exposure of 5 ms, the camera says 15.6 ms"),
        (cv2.CAP_PROP_AUTOFOCUS, 1.0, {}, "asked for a fixed focus, the camera keeps refocusing"),
        (cv2.CAP_PROP_AUTOFOCUS, 0.0, {"autofocus": True}, "asked for autofocus, the camera has none"),
    ],
)
def test_what_the_driver_substitutes_is_told(
    device: FakeDevice, prop: int, found: float, table: dict[str, Any], sentence: str
) -> None:
    device.fixed.add(prop)
    device.values[prop] = found
    differ = apply_settings(device, options(**table))
    assert len(differ) == 1
    assert sentence in differ[0]


def test_a_camera_without_exposure_and_focus_controls_gives_no_reason_to_complain(device: FakeDevice) -> None:
    device.fixed |= {cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_AUTOFOCUS}
    assert apply_settings(device, options()) == ()


def test_the_size_is_judged_by_the_picture() -> None:
    picture = np.zeros((480, 640, 3), np.uint8)
    assert size_differs(picture, options()) == ()
    assert size_differs(picture, options(width_px=640, height_px=480)) == ()
    (sentence,) = size_differs(picture, options(width_px=1280, height_px=720))
    assert "1280 × 720" in sentence
    assert "640 × 480" in sentence


@pytest.mark.parametrize(
    ("device_option", "is_stream"),
    [(0, False), ("/dev/v4l/by-id/usb-cam-index0", False), ("rtsp://10.0.0.9/live", True), ("http://cam/v", True)],
)
def test_a_device_is_a_number_a_path_or_an_address(device_option: int | str, is_stream: bool) -> None:
    assert OpenCvOptions.model_validate({"device": device_option}).is_stream is is_stream


@each_case(
    ("table", "missing"),
    [
        ({"device": 0}, []),
        ({"device": "/dev/video0", "latency": "30 ms"}, []),
        ({"device": "http://cam/stream"}, ["latency"]),
        ({"device": "RTSP://cam/live", "latency": "0 s"}, []),
        ({"device": "tcp://cam:8888", "latency": "100 ms"}, []),
        ({"device": "udp://127.0.0.1:5000"}, ["latency", "accept_lossy_stream"]),
        ({"device": "srt://cam:9000", "latency": "100 ms"}, ["accept_lossy_stream"]),
        ({"device": "rtp://127.0.0.1:5000", "latency": "100 ms", "accept_lossy_stream": True}, []),
    ],
)
def test_nothing_moves_on_a_stream_of_unknown_age_or_with_losses(table: dict[str, object], missing: list[str]) -> None:
    options = OpenCvOptions.model_validate(table)
    assert list(options.refuse_motion()) == missing
    why = OpenCvCamera(options, ManualClock()).not_for_motion
    assert why == next(iter(options.refuse_motion().values()), "")
    assert all(key in sentence for key, sentence in options.refuse_motion().items())


def test_rtsp_over_udp_loses_packets(monkeypatch: pytest.MonkeyPatch) -> None:
    options = OpenCvOptions.model_validate({"device": "rtsp://cam/live", "latency": "100 ms"})
    assert "rtsp_transport;tcp" in os.environ[FFMPEG_OPTIONS]
    monkeypatch.setenv(FFMPEG_OPTIONS, "rtsp_transport;udp")
    assert list(options.refuse_motion()) == ["accept_lossy_stream"]


def test_what_is_no_camera_is_refused_without_its_password() -> None:
    with pytest.raises(ValueError, match="is not a camera") as raised:
        OpenCvOptions.model_validate({"device": "me:secret@10.0.0.9/live"})
    assert "secret" not in str(raised.value.errors()[0]["msg"])


# Cameras on this computer, found in a tree as Linux has it; a double answers for the kernel by its structures.


@pytest.fixture
def kernel(tmp_path: Path) -> Kernel:
    return Kernel(tmp_path)


def test_without_a_camera_there_is_none(tmp_path: Path) -> None:
    assert attached_devices(tmp_path) == ()


def test_a_camera_is_named_by_the_path_that_stays_right(kernel: Kernel) -> None:
    kernel.add("video2", Node(), by_id="usb-046d_C615-video-index0", by_path="pci-0-usb-0:1:1.0-video-index0")
    (camera,) = attached_devices(kernel.root, kernel)
    assert camera.path == f"{kernel.root}/dev/v4l/by-id/usb-046d_C615-video-index0"
    assert camera.choice == f"opencv,device={camera.path}"
    assert (camera.name, camera.trouble) == ("HD Webcam C615", "")
    assert camera.node == f"{kernel.root}/dev/video2"


def test_formats_that_can_be_read_are_listed_with_sizes_and_rates(kernel: Kernel) -> None:
    kernel.add("video0", Node())
    (camera,) = attached_devices(kernel.root, kernel)
    assert camera.modes == tuple(
        CameraMode(fourcc=fourcc, width_px=width_px, height_px=height_px, rates_hz=(30.0, 15.0, 7.5))
        for fourcc in ("MJPG", "YUYV")
        for width_px, height_px in ((640, 480), (1280, 720))
    )


def test_of_a_camera_that_scales_to_any_size_the_usual_ones_and_the_largest_are_listed(kernel: Kernel) -> None:
    any_size = (3, 32, 2592, 2, 32, 1944, 2)
    any_rate = (2, 1, 90, 1, 1, 1, 1)
    kernel.add("video0", Node(formats=("YUYV",), sizes=(any_size,), intervals=(any_rate,)))
    (camera,) = attached_devices(kernel.root, kernel)
    sizes = [(each.width_px, each.height_px) for each in camera.modes]
    assert sizes == [(640, 480), (1280, 720), (1920, 1080), (2592, 1944)]
    assert {each.rates_hz for each in camera.modes} == {(90.0,)}


@pytest.mark.parametrize(
    "node",
    [
        Node(capabilities=METADATA),
        Node(formats=("H264",)),
        Node(driver="bcm2835-isp"),
        Node(capabilities=CAPTURE | v4l2.NEEDS_MEDIA_CONTROLLER, driver="unicam"),
    ],
    ids=["metadata", "video only", "converter", "ribbon camera"],
)
def test_a_node_that_gives_opencv_no_pictures_is_left_out(kernel: Kernel, node: Node) -> None:
    kernel.add("video0", Node())
    kernel.add("video1", node, index=1)
    assert [camera.node for camera in attached_devices(kernel.root, kernel)] == [f"{kernel.root}/dev/video0"]


def test_nodes_are_listed_by_their_number(kernel: Kernel) -> None:
    for name in ("video10", "video2", "video0"):
        kernel.add(name, Node(card=name))
    assert [camera.name for camera in attached_devices(kernel.root, kernel)] == ["video0", "video2", "video10"]


def test_cameras_of_one_make_without_serial_numbers_are_named_by_their_sockets(kernel: Kernel) -> None:
    kernel.add("video0", Node(), by_id="usb-C615-video-index0", by_path="usb-0:1-video-index0")
    kernel.add("video2", Node(), by_id="usb-C615-video-index0", by_path="usb-0:2-video-index0")
    kernel.add("video4", Node(card="Other"), by_id="usb-Other-video-index0", by_path="usb-0:3-video-index0")
    paths = [Path(camera.path).name for camera in attached_devices(kernel.root, kernel)]
    assert paths == ["usb-0:1-video-index0", "usb-0:2-video-index0", "usb-Other-video-index0"]


def test_a_camera_in_use_is_listed_and_said_to_be(kernel: Kernel) -> None:
    kernel.add("video0", Node(in_use=True))
    (camera,) = attached_devices(kernel.root, kernel)
    assert "another program is using it" in camera.trouble
    assert camera.modes


@pytest.mark.parametrize(
    ("error", "words"),
    [(errno.EACCES, "group 'video'"), (errno.ENXIO, "is missing; a container"), (errno.EBUSY, "another program")],
)
def test_a_camera_that_cannot_be_opened_is_listed_once_with_the_reason(
    kernel: Kernel, error: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel.add("video0", Node(), by_id="usb-C615-video-index0")
    kernel.add("video1", Node(capabilities=METADATA), index=1)

    def refuse(*_: object) -> int:
        raise OSError(error, os.strerror(error))

    (camera,) = attached_devices(kernel.root, refuse)
    assert words in camera.trouble
    assert (camera.name, Path(camera.path).name) == ("HD Webcam C615", "usb-C615-video-index0")


def test_of_nodes_that_cannot_be_asked_those_on_usb_are_taken_for_cameras(kernel: Kernel) -> None:
    for name, bus in (("video0", "usb"), ("video10", "platform")):
        kernel.add(name, Node(card=bus))
        (kernel.root / "sys/bus" / bus).mkdir(parents=True)
        (kernel.root / "sys/class/video4linux" / name / "device").mkdir()
        (kernel.root / "sys/class/video4linux" / name / "device/subsystem").symlink_to(kernel.root / "sys/bus" / bus)

    def refuse(*_: object) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    assert [camera.name for camera in attached_devices(kernel.root, refuse)] == ["usb"]


def test_a_file_is_no_video4linux_node_for_the_real_kernel(tmp_path: Path) -> None:
    (tmp_path / "video0").touch()
    with pytest.raises(OSError, match="ioctl") as raised:
        v4l2.ask_node(tmp_path / "video0")
    assert raised.value.errno == errno.ENOTTY
    assert not v4l2.is_in_use(tmp_path / "video0")


# Cameras that hang or vanish, and come back with other settings: how soon they are used, and how they are set then.

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
