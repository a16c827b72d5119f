"""The command ``calibrate check``."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from support.command_line import Typed, typed

SHEET = ("--sheet", "11in,8.5in")


def _run(*arguments: object) -> Typed:
    return typed("calibrate", "check", *arguments)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """A sheet that is 30 in away at a focal length of 600 px."""
    image = np.full((480, 640, 3), (70, 100, 120), np.uint8)
    cv2.rectangle(image, (210, 155), (429, 324), (230, 232, 228), -1)
    cv2.imwrite(str(tmp_path / "sheet.png"), image)
    return tmp_path / "sheet.png"


def _camera(folder: Path, focal_px: float) -> Path:
    path = folder / "camera.toml"
    save_camera_model(path, CameraModel.with_focal_length(focal_px, 640, 480))
    return path


def test_a_right_camera_file_is_said_to_be_right(picture: Path, tmp_path: Path) -> None:
    result = _run(f"{picture}@30in", "--camera", _camera(tmp_path, 600), *SHEET)
    assert result.returncode == 0
    assert "instead of 30.0 in:" in result.stdout
    assert result.stdout.splitlines()[-1].endswith("is right within what it states")


def test_a_wrong_camera_file_is_said_to_be_wrong_by_how_much_and_which_way(picture: Path, tmp_path: Path) -> None:
    result = _run(f"{picture}@30in", "--camera", _camera(tmp_path, 660), *SHEET)
    assert result.returncode == 1
    line, mean, verdict = result.stdout.splitlines()
    assert "+10." in line
    assert "σ  outside" in line
    assert mean.startswith("mean error +10.")
    assert "is wrong: it reads 10." in verdict
    assert "% too far" in verdict


@pytest.mark.long
def test_a_picture_without_the_target_exits_1(picture: Path, tmp_path: Path) -> None:
    wall = tmp_path / "wall.png"
    cv2.imwrite(str(wall), np.full((480, 640, 3), 90, np.uint8))
    result = _run(f"{picture}@30in", f"{wall}@30in", "--camera", _camera(tmp_path, 600), *SHEET)
    assert result.returncode == 1
    assert result.stderr.startswith(f"left out: {wall}: ")
    alone = _run(f"{wall}@30in", "--camera", _camera(tmp_path, 600), *SHEET)
    assert (alone.returncode, alone.stdout) == (1, "")
    assert "nothing was checked" in alone.stderr
