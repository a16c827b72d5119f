"""The command ``calibrate floor``, and what `measure` makes of the lines that it prints."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import cv2
import pytest

from stadimeter.config.camera_file import save_camera_model
from support.command_line import Typed, typed
from support.scenes.draw import CAMERA, TAG_M
from support.scenes.on_floor import ball_on_floor, tag_lying
from support.scenes.render import render

BALL = 5
TAG = ("--tag", f"{TAG_M} m", "--family", "36h11")
CONFIGURATION = """
{lines}
driver = "images"
paths = ["ball.png"]
model = "camera.toml"

[targets.ball]
detector = "ball"
diameter = "{diameter}"
hsv = "{hsv}"
on_floor = true
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_camera_model(tmp_path / "camera.toml", CAMERA)
    cv2.imwrite(str(tmp_path / "tag.png"), render(tag_lying(3, 0.7).scene).image)
    return tmp_path


def calibrate(folder: Path, *pictures: str) -> Typed:
    paths = [folder / name for name in pictures]
    return typed("calibrate", "floor", *paths, "--camera", folder / "camera.toml", *TAG)


def test_a_tag_on_the_floor_gives_the_lines_for_the_camera(folder: Path) -> None:
    result = calibrate(folder, "tag.png")
    assert result.returncode == 0
    found = re.search(
        r'\[camera\]\nheight = "([\d.]+) cm ± ([\d.]+) mm"\ntilt = "(-[\d.]+) deg ± ([\d.]+) deg"', result.stdout
    )
    assert found is not None
    height_cm, off_mm, tilt_deg, off_deg = map(float, found.groups())
    drawn = tag_lying(3, 0.7)
    assert abs(height_cm / 100 - drawn.height_m) < 3 * off_mm / 1000
    assert abs(tilt_deg - math.degrees(drawn.tilt_rad)) < 3 * off_deg


def test_a_ball_on_that_floor_is_measured_by_size_and_floor_and_explained(folder: Path) -> None:
    lines = calibrate(folder, "tag.png").stdout
    lines = lines[lines.index("[camera]") :]
    ball = ball_on_floor(BALL, 1.0)
    made = render(ball.scene)
    cv2.imwrite(str(folder / "ball.png"), made.image)
    (folder / "run.toml").write_text(CONFIGURATION.format(lines=lines, diameter="12 cm", hsv=ball.hsv))
    found = json.loads(
        typed("measure", folder / "ball.png", "--config", folder / "run.toml", "--json", "--explain").stdout
    )
    assert found["distance_m"] == pytest.approx(made.truth.distance_m, rel=0.02)
    assert found["floor_distance_m"] == pytest.approx(made.truth.distance_m, rel=0.05)
    assert found["floor_apart_sigmas"] < 3
    assert found["reason"] == ""
    words = typed("measure", folder / "ball.png", "--config", folder / "run.toml", "--explain").stdout
    assert re.search(r"floor +1\.\d+ m ± [\d.]+ by the floor, [\d.]+ m ± [\d.]+ by its size, [\d.]+ σ apart", words)


def test_a_picture_without_the_tag_and_what_tells_nothing_of_the_floor_are_said(folder: Path) -> None:
    cv2.imwrite(str(folder / "wall.png"), render(ball_on_floor(BALL, 1.0).scene).image)
    some = calibrate(folder, "tag.png", "wall.png")
    assert some.returncode == 1
    assert "left out" in some.stderr
    assert "[camera]" in some.stdout
    none = calibrate(folder, "wall.png")
    assert none.returncode == 1
    assert "[camera]" not in none.stdout
    ball = typed("calibrate", "floor", folder / "tag.png", "--camera", folder / "camera.toml", "--ball", "67 mm")
    assert ball.returncode == 2
    assert "lay a tag or a sheet on it" in ball.stderr
