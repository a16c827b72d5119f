"""`cameras`, `snapshot` and the option ``--live``, with doubles of the kernel and of a Video4Linux device."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.core.frame import Image
from support.command_line import typed
from support.v4l2_double import Kernel, Node, V4l2Double

pytestmark = pytest.mark.vision


# `cameras` and `snapshot`, with doubles of the kernel and of a Video4Linux device.


def _room() -> Image:
    """Return a sharp, evenly lit picture."""
    image = np.full((480, 640, 3), 120, np.uint8)
    cv2.rectangle(image, (200, 150), (440, 330), (60, 200, 220), -1)
    return image


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kernel:
    kernel = Kernel(tmp_path)
    kernel.answers(monkeypatch)
    return kernel


@pytest.fixture
def device(kernel: Kernel, monkeypatch: pytest.MonkeyPatch) -> V4l2Double:
    kernel.add("video0", Node(), by_id="usb-C615-video-index0")
    return V4l2Double.plugged_in(kernel.root / "dev/v4l/by-id/usb-C615-video-index0", _room(), monkeypatch)


def test_a_camera_is_listed_with_the_lines_to_paste_and_what_it_took(device: V4l2Double) -> None:
    result = typed("cameras")
    assert result.returncode == 0
    assert result.stdout.splitlines() == [
        f"1  HD Webcam C615, now {device.node.resolve()}",
        '   driver = "opencv"',
        f'   device = "{device.node}"',
        "   MJPG: 640 × 480 at 30 Hz, 1280 × 720 at 30 Hz",
        "   YUYV: 640 × 480 at 30 Hz, 1280 × 720 at 30 Hz",
        "   gives 640 × 480: it took every setting",
    ]


def test_cameras_are_listed_for_programs(device: V4l2Double) -> None:
    (record,) = json.loads(typed("cameras", "--json").stdout)
    assert record["live"] == f"opencv,device={device.node}"
    assert (record["width_px"], record["trouble"], record["settings_not_taken"]) == (640, "", [])
    assert record["modes"][0] == {"fourcc": "MJPG", "width_px": 640, "height_px": 480, "rates_hz": [30.0, 15.0, 7.5]}


def test_a_camera_in_use_is_named_and_not_opened(kernel: Kernel) -> None:
    kernel.add("video0", Node(in_use=True))
    result = typed("cameras")
    assert result.returncode == 1
    assert "cannot be used: another program is using it" in result.stdout


def test_a_camera_that_does_not_open_is_said_and_the_next_one_is_looked_at(device: V4l2Double, kernel: Kernel) -> None:
    kernel.add("video2", Node(card="Broken"), by_id="usb-Broken-video-index0")
    result = typed("cameras")
    assert result.returncode == 1
    assert "gives 640 × 480" in result.stdout
    _, broken = result.stdout.split("2  Broken")
    assert "cannot be used: the camera" in broken


def test_without_trying_no_camera_is_opened(device: V4l2Double) -> None:
    result = typed("cameras", "--no-try")
    assert result.returncode == 0
    assert device.set_to == {}
    assert "gives" not in result.stdout


def test_where_no_camera_is_it_says_what_to_look_at(kernel: Kernel) -> None:
    result = typed("cameras")
    assert result.returncode == 1
    assert "Is its cable plugged in, and does `ls /dev/video*` list it?" in result.stderr


def test_a_snapshot_has_the_settings_of_the_configuration(device: V4l2Double, tmp_path: Path) -> None:
    config = tmp_path / "room.toml"
    config.write_text(f'[camera]\ndriver = "opencv"\ndevice = "{device.node}"\nexposure = "10 ms"\n')
    result = typed("snapshot", config, "-o", tmp_path / "room.png")
    assert result.returncode == 0
    assert device.set_to[cv2.CAP_PROP_EXPOSURE] == 100
    assert device.set_to[cv2.CAP_PROP_AUTOFOCUS] == 0
    assert result.stdout == f"wrote {tmp_path / 'room.png'}: 640 × 480 pixels\n"
    assert "a photograph by another program may have another focal length" in result.stderr
    assert np.abs(cv2.imread(str(tmp_path / "room.png")).astype(int) - _room()).max() <= 2


def test_a_setting_that_was_not_taken_and_a_bad_picture_are_said(device: V4l2Double, tmp_path: Path) -> None:
    device.kept[cv2.CAP_PROP_AUTOFOCUS] = 1.0
    device.show(np.full((480, 640, 3), 4, np.uint8))
    result = typed("snapshot", "--live", f"opencv,device={device.node}", "-o", tmp_path / "a.png")
    assert result.returncode == 1
    notes = result.stderr.splitlines()
    assert notes[0] == "note: asked for a fixed focus, the camera keeps refocusing: distances will drift"
    assert notes[1].startswith("note: the picture is black")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "give a configuration, or --live"),
        (("nowhere.toml",), "nowhere.toml"),
        (("--live", "opencv,device=947"), "there is no camera /dev/video947"),
    ],
)
def test_a_snapshot_that_cannot_be_taken_is_one_line(tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    result = typed("snapshot", *arguments, "-o", tmp_path / "a.png")
    assert result.returncode == 2
    (error,) = result.stderr.splitlines()
    assert words in error


# The option ``--live``, and `measure` with it before a double of a Video4Linux device.
