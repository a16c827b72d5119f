"""``--disc`` of the commands that look for a target."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import load_camera_model, save_camera_model
from support.command_line import typed
from support.scenes.backdrop import PlainBackdrop
from support.scenes.draw import CAMERA
from support.scenes.plane import DiscTarget, Pose
from support.scenes.render import render
from support.scenes.scene import Scene


@pytest.fixture
def picture(tmp_path: Path):
    def make(distance_m: float, tilt_deg: float = 0.0) -> Path:
        pose = Pose(position_m=(0.0, 0.0, distance_m), tilt_rad=math.radians(tilt_deg))
        target = DiscTarget(pose=pose, diameter_m=0.12)
        made = render(Scene(camera=CAMERA, target=target, seed=3, backdrop=PlainBackdrop()))
        path = tmp_path / f"{distance_m}_{tilt_deg}.png"
        cv2.imwrite(str(path), np.asarray(made.image))
        return path

    return make


def test_a_disc_is_measured_though_it_is_tilted(picture, tmp_path: Path) -> None:
    save_camera_model(tmp_path / "camera.toml", CAMERA)
    result = typed("measure", picture(0.8, 40.0), "--camera", tmp_path / "camera.toml", "--disc", "12cm")
    assert result.returncode == 0
    assert "80.0 cm" in result.stdout


def test_a_camera_is_calibrated_and_checked_with_a_disc(picture, tmp_path: Path) -> None:
    file = tmp_path / "camera.toml"
    made = typed("calibrate", "distance", f"{picture(0.5)}@50cm", f"{picture(1.5)}@150cm", "--disc", "12cm", "-o", file)
    assert made.returncode == 0, made.stderr
    assert load_camera_model(file).fx_px == pytest.approx(600.0, rel=2e-3)
    checked = typed("calibrate", "check", f"{picture(1.0)}@1m", "--camera", file, "--disc", "12cm")
    assert checked.returncode == 0, checked.stdout
