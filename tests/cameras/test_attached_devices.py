"""Cameras on this computer, found in a tree as Linux has it; a double answers for the kernel by its structures."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from stadimeter.cameras import v4l2
from stadimeter.cameras.protocol import CameraMode
from stadimeter.cameras.v4l2 import attached_devices
from support.v4l2_kernel import CAPTURE, METADATA, Kernel, Node


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
