"""The camera contract over every camera, and wrong cameras, each of which fails the test beside it."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras.image_files import ImageFilesCamera
from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from stadimeter.cameras.picamera2_camera import Picamera2Camera, Picamera2Options
from stadimeter.cameras.video_file import VideoFileCamera
from stadimeter.config.plugins import CAMERAS, WORLDS, DriverContext, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError
from stadimeter.testing.camera_contract import FRAMES, CameraContract, CameraRig
from stadimeter.testing.rig import ManualClock
from support.cameras import NodeDevice, NodeHandle, StreamServer, open_files, picture
from support.each_case import each_case
from support.picamera2_double import Sensor

# The camera contract over every camera. A new camera gets a class here with a fixture ``make_rig``.


class TestImageFiles(CameraContract):
    @pytest.fixture
    def make_rig(self, tmp_path: Path) -> Callable[[], CameraRig]:
        def rig() -> CameraRig:
            for number in range(FRAMES):
                cv2.imwrite(str(tmp_path / f"{number}.png"), picture(number))
            clock = ManualClock(100.0)
            return CameraRig(
                camera=ImageFilesCamera((str(tmp_path),), 5.0, clock),
                clock=clock,
                absent=ImageFilesCamera((str(tmp_path / "absent.png"),), 5.0, clock),
                lose=(tmp_path / "1.png").unlink,
            )

        return rig


class TestVideoFile(CameraContract):
    @pytest.fixture
    def make_rig(self, tmp_path: Path) -> Callable[[], CameraRig]:
        def rig() -> CameraRig:
            path, clock = tmp_path / "clip.mp4", ManualClock(100.0)
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (64, 48))
            for number in range(FRAMES):
                writer.write(picture(number))
            writer.release()
            return CameraRig(
                camera=VideoFileCamera(path, None, clock),
                clock=clock,
                absent=VideoFileCamera(tmp_path / "absent.mp4", None, clock),
                held=lambda: open_files(path),
            )

        return rig


class TestOpenCvNode(CameraContract):
    @pytest.fixture
    def make_rig(self, tmp_path: Path) -> Callable[[], CameraRig]:
        def rig() -> CameraRig:
            node, clock, device = tmp_path / "video0", MonotonicClock(), NodeDevice()
            node.touch()

            def camera(path: Path) -> OpenCvCamera:
                options = OpenCvOptions.model_validate({"device": str(path), "read_timeout": "200 ms"})
                return OpenCvCamera(options, clock, open_capture=device)

            return CameraRig(
                camera=camera(node),
                clock=clock,
                absent=camera(tmp_path / "absent"),
                held=lambda: len(device.handles),
                lose=device.fail,
            )

        return rig


class TestOpenCvStream(CameraContract):
    @pytest.fixture
    def server(self) -> Iterator[StreamServer]:
        server = StreamServer()
        yield server
        server.stop()

    @pytest.fixture
    def make_rig(self, server: StreamServer) -> Iterator[Callable[[], CameraRig]]:
        clock = MonotonicClock()
        with socket.socket() as bound_but_silent:
            bound_but_silent.bind(("127.0.0.1", 0))
            absent = f"http://127.0.0.1:{bound_but_silent.getsockname()[1]}/cam"
            yield lambda: CameraRig(
                camera=OpenCvCamera(OpenCvOptions(device=server.address), clock),
                clock=clock,
                absent=OpenCvCamera(OpenCvOptions(device=absent), clock),
                held=lambda: server.connections,
                lose=server.stop,
            )


class TestPicamera2(CameraContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], CameraRig]:
        def rig() -> CameraRig:
            clock = MonotonicClock()
            sensor, nothing = Sensor(clock), Sensor(clock, is_there=False)

            def camera(of: Sensor) -> Picamera2Camera:
                table = {"width_px": 66, "height_px": 48, "rate": "100 Hz", "read_timeout": "500 ms"}
                options = Picamera2Options.model_validate(table)
                return Picamera2Camera(options, clock, of.package, monotonic=clock.now_s)

            return CameraRig(
                camera=camera(sensor),
                clock=clock,
                absent=camera(nothing),
                held=lambda: sensor.held,
                lose=lambda: setattr(sensor, "is_silent", True),
            )

        return rig


LENS = CameraModel.with_focal_length(150.0, 160, 120)


def in_a_world(clock: Clock) -> DriverContext:
    context = DriverContext(name="it", clock=clock, camera_model=LENS)
    model = load_driver(WORLDS, "simulated")
    model().build(context)
    return context


class TestSimulatedCamera(CameraContract):
    @pytest.fixture(params=[ManualClock, MonotonicClock], ids=["stepped", "real"])
    def clock(self, request: pytest.FixtureRequest) -> Clock:
        made: Clock = request.param()
        return made

    @pytest.fixture(params=[True, False], ids=["drawn", "black"])
    def make_rig(self, clock: Clock, request: pytest.FixtureRequest) -> Callable[[], CameraRig]:
        def rig() -> CameraRig:
            model = load_driver(CAMERAS, "simulated")
            options = model.model_validate({"rate": "1 kHz", "render": request.param})
            return CameraRig(camera=options.build(in_a_world(clock)), clock=clock)

        return rig


# The camera contract catches mistakes: each wrong camera fails the test that is named beside it.


class NodeCamera:
    """A right camera over a device that counts its handles, until a method of it is replaced."""

    is_live = True
    remarks: tuple[str, ...] = ()
    not_for_motion = ""

    def __init__(self, device: NodeDevice, clock: ManualClock) -> None:
        self.device, self.clock = device, clock
        self.handle: NodeHandle | None = None
        self.number = 0

    def open(self) -> None:
        self.close()
        self.handle = self.device()

    def read(self) -> Frame:
        if self.handle is None:
            raise DeviceClosedError("not open")
        self.clock.advance_s(0.1)
        frame = Frame(self.image(self.handle), self.captured_at_s(), self.number)
        self.number += 1
        return frame

    def image(self, handle: NodeHandle) -> Any:
        try:
            return handle.retrieve()[1]
        except cv2.error as error:
            raise CaptureTimeoutError("no picture came") from error

    def captured_at_s(self) -> float:
        return self.clock.now_s()

    def close(self) -> None:
        if self.handle is not None:
            self.handle.release()
            self.handle = None


def go_on_with_the_last_picture(it: Any, handle: NodeHandle) -> Any:
    with suppress(cv2.error):
        it.last = handle.retrieve()[1]
    return it.last


def use_four_buffers_in_turn(it: Any, handle: NodeHandle) -> Any:
    it.buffers = it.__dict__.get("buffers") or [np.zeros((48, 64, 3), np.uint8) for _ in range(4)]
    it.buffers[it.number % 4][:] = handle.retrieve()[1]
    return it.buffers[it.number % 4]


def begin_stamps_anew(it: Any) -> None:
    NodeCamera.open(it)
    opened_at_s = it.clock.now_s()
    it.captured_at_s = lambda: 90.0 + it.clock.now_s() - opened_at_s


def begin_numbers_anew(it: Any) -> None:
    NodeCamera.open(it)
    it.number = 0


HELD = "test_the_device_is_taken_once_by_open_and_let_go_by_close"
LOST = "test_a_lost_device_ends_reading_with_an_error_of_ours"
AGAIN = "test_a_closed_camera_opens_again_and_time_and_numbers_go_on"
MISTAKES: list[tuple[str, str, Callable[..., Any]]] = [
    (LOST, "image", lambda _it, handle: handle.retrieve()[1]),
    (LOST, "image", go_on_with_the_last_picture),
    (
        "test_the_device_is_taken_once_by_open_and_let_go_by_close",
        "open",
        lambda it: setattr(it, "handle", it.device()),
    ),
    ("test_the_device_is_taken_once_by_open_and_let_go_by_close", "close", lambda it: setattr(it, "handle", None)),
    (
        "test_reading_needs_an_open_camera_which_may_be_closed_at_any_time_and_again",
        "close",
        lambda it: it.handle and it.handle.release(),
    ),
    ("test_a_frames_image_is_not_changed_by_later_reads", "image", use_four_buffers_in_turn),
    (
        "test_numbers_rise_and_capture_times_never_go_back_nor_ahead_of_the_clock",
        "captured_at_s",
        lambda it: it.clock.now_s() - (0.5 if it.number == 7 else 0.0),
    ),
    (AGAIN, "open", begin_stamps_anew),
    (AGAIN, "open", begin_numbers_anew),
]
"""The test that catches each, the method that is wrong, and what stands in its place."""


def node_rig(**replaced: Callable[..., Any]) -> CameraRig:
    device, clock = NodeDevice(), ManualClock(100.0)
    camera = NodeCamera(device, clock)
    for name, method in replaced.items():
        setattr(camera, name, partial(method, camera))
    return CameraRig(camera=camera, clock=clock, held=lambda: len(device.handles), lose=device.fail)


@each_case(("test", "method", "wrong"), MISTAKES)
def test_a_wrong_camera_fails_the_test_for_its_mistake(test: str, method: str, wrong: Callable[..., Any]) -> None:
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        getattr(CameraContract(), test)(node_rig(**{method: wrong}))


@each_case("test", sorted({test for test, *_ in MISTAKES}))
def test_a_right_camera_passes_the_same_tests(test: str) -> None:
    getattr(CameraContract(), test)(node_rig())
