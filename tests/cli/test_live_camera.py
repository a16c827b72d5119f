"""The option ``--live``, and `measure` with it before a double of a Video4Linux device."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.cli.target_options import camera_choice
from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.workbench.frame_source import Source
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.v4l2_double import V4l2Double

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
