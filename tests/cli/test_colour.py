"""`colour`: the range of colours of a ball, as a person finds it out."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from support.command_line import Typed, typed

pytestmark = pytest.mark.vision

GREEN, ORANGE = (60, 170, 70), (30, 110, 230)


def _picture(path: Path, *balls: tuple[tuple[int, int], int, tuple[int, int, int]], light: float = 1.0) -> Path:
    image = np.full((480, 640, 3), (150, 155, 160), np.uint8)
    for centre, radius_px, bgr in balls:
        cv2.circle(image, centre, radius_px, bgr, cv2.FILLED, cv2.LINE_AA)
    noise = np.random.default_rng(0).normal(0, 2, image.shape)
    cv2.imwrite(str(path), np.clip(light * image + noise, 0, 255).astype(np.uint8))
    return path


@pytest.fixture
def green_ball(tmp_path: Path) -> Path:
    return _picture(tmp_path / "ball.png", ((300, 200), 40, GREEN))


def _range_in(output: str) -> str:
    found = re.search(r'^hsv = "(.+)"$', output, re.MULTILINE)
    assert found, output
    return found[1]


def _measured(picture: Path, colour: str) -> Typed:
    camera = picture.parent / "camera.toml"
    save_camera_model(camera, CameraModel.with_focal_length(600.0, 640, 480))
    return typed("measure", picture, "--camera", camera, "--ball", "6.4cm", "--hsv", colour)


def test_a_ball_without_a_colour_is_advised_to_be_measured_without_a_range(tmp_path: Path) -> None:
    silver = _picture(tmp_path / "ball.png", ((300, 200), 40, (190, 190, 190)))
    told = typed("colour", silver, "--annotate", tmp_path)
    assert told.returncode == 2
    assert "nothing in the picture stands out as a ball of one colour" in told.stderr
    assert "such as a silver or a white one, is measured by its edge: give none" in told.stderr
    camera = tmp_path / "camera.toml"
    save_camera_model(camera, CameraModel.with_focal_length(600.0, 640, 480))
    assert typed("measure", silver, "--camera", camera, "--ball", "6.4cm").returncode == 0


@pytest.mark.long
@pytest.mark.parametrize("at", [[], ["--at", "310,190"], ["--at", "290,210", "--at", "315,205"]])
def test_a_ball_is_measured_with_the_range_that_is_proposed_for_it(green_ball: Path, at: list[str]) -> None:
    told = typed("colour", green_ball, *at, "--annotate", green_ball.parent)
    assert told.returncode == 0
    assert "a ball at 300,200, 81 px across" in told.stdout
    assert "no other thing has a hue near it" in told.stdout
    assert _measured(green_ball, _range_in(told.stdout)).returncode == 0


def test_a_folder_of_pictures_is_left_as_it_is_unless_copies_are_asked_for(green_ball: Path) -> None:
    told = typed("colour", green_ball, "--json")
    assert told.returncode == 0
    assert json.loads(told.stdout)["pictures"][0]["copy"] is None
    assert [each.name for each in green_ball.parent.iterdir()] == [green_ball.name]


def test_pointing_at_the_background_says_so(green_ball: Path) -> None:
    told = typed("colour", green_ball, "--at", "600,20", "--annotate", green_ball.parent)
    assert told.returncode == 2
    assert "it is background; point at the middle of the ball" in told.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--at", "900,20"], "900,20 is not in"),
        (["--at", "here"], "'here' is not a place; write it such as 312,240"),
        (["nowhere.png", "--at", "3,4"], "--at is a place in one picture"),
    ],
)
def test_a_place_that_is_none_is_refused(green_ball: Path, arguments: list[str], words: str) -> None:
    told = typed("colour", green_ball, *arguments)
    assert told.returncode == 2
    assert words in told.stderr


def test_a_camera_gives_the_picture_too(tmp_path: Path, green_ball: Path) -> None:
    told = typed("colour", "--live", f"images,paths=['{green_ball}']", "--annotate", tmp_path)
    assert told.returncode == 0, told.stderr
    assert (tmp_path / "live-colour.png").is_file()


def test_measure_proposes_a_range_where_no_pixel_has_the_colour(green_ball: Path) -> None:
    told = _measured(green_ball, "110,150,60:130,255,255")
    assert told.returncode == 1
    assert "something round, 81 px across at 300,200, has other colours" in told.stderr
    found = re.search(r'hsv = "(.+)"', told.stderr)
    assert found
    assert _measured(green_ball, found[1]).returncode == 0
