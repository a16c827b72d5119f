"""`cameras`, `snapshot` and the option ``--live``, with doubles of the kernel and of a Video4Linux device."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.cli.target_options import camera_choice
from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.workbench.frame_source import Source
from support.command_line import typed
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene
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

LENS = CameraModel.with_focal_length(600.0, 640, 480)


def test_a_device_by_itself_is_read_by_opencv() -> None:
    for live, device, exposure in [
        ("0", 0, None),
        ("/dev/v4l/by-id/usb-C615-video-index0", "/dev/v4l/by-id/usb-C615-video-index0", None),
        ("http://10.0.0.9:8080/?action=stream", "http://10.0.0.9:8080/?action=stream", None),
        ("2,exposure=10ms", 2, 0.01),
        ("opencv,device=0,exposure=10ms", 0, 0.01),
    ]:
        choice = camera_choice(live)
        assert (choice.driver, choice.options.device, choice.options.exposure) == ("opencv", device, exposure)


@pytest.mark.vision
def test_a_device_is_measured_frame_after_frame_until_ctrl_c(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = BallTarget(position_m=(0.0, 0.0, 1.5), diameter_m=0.2)
    image = render(Scene(camera=LENS, target=ball, seed=1, backdrop=PlainBackdrop())).image
    device = V4l2Double.plugged_in(tmp_path / "video0", image, monkeypatch)
    save_camera_model(tmp_path / "camera.toml", LENS)
    endless = Source.frames

    def three_frames(source: Source, note: Callable[[str], None]) -> Iterator[Frame]:
        yield from islice(endless(source, note), 3)
        raise KeyboardInterrupt

    monkeypatch.setattr(Source, "frames", three_frames)
    target = ["--ball", "20cm", "--hsv", "20,60,40:50,255,255", "--camera", str(tmp_path / "camera.toml")]
    result = CliRunner().invoke(app, ["measure", "--live", f"opencv,device={device.node}", *target, "--json"])
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [each["distance_m"] for each in records] == pytest.approx([1.5] * 3, rel=0.01)
    assert records[0]["time_s"] == 0 < records[1]["time_s"] < records[2]["time_s"]
    assert "stopped after 3 frames" in result.stderr
    assert not device.isOpened()
