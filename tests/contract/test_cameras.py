"""The camera contract over every camera. A new camera gets a class here with a fixture ``make_rig``."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras.image_files import ImageFilesCamera
from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from stadimeter.cameras.picamera2_camera import Picamera2Camera, Picamera2Options
from stadimeter.cameras.video_file import VideoFileCamera
from stadimeter.config.plugins import CAMERAS, WORLDS, DriverContext, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.clock import Clock
from stadimeter.testing.camera_contract import FRAMES, CameraContract, CameraRig
from stadimeter.testing.rig import ManualClock
from support.cameras import NodeDevice, StreamServer, open_files, picture
from support.picamera2_double import Sensor


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
