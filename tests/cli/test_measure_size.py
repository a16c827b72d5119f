"""``measure --at``, two targets, and the robot's frame."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from support.command_line import Typed, typed

SHEET = ("--sheet", "11in,8.5in")


def run(*arguments: object) -> Typed:
    return typed("measure", *arguments)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sheet that is 30 in away at a focal length of 600 px."""
    image = np.full((480, 640, 3), (70, 100, 120), np.uint8)
    cv2.rectangle(image, (210, 155), (429, 324), (230, 232, 228), -1)
    cv2.imwrite(str(tmp_path / "sheet.png"), image)
    save_camera_model(tmp_path / "camera.toml", CameraModel.with_focal_length(600, 640, 480))
    return tmp_path


def given(folder: Path, *arguments: object) -> tuple[object, ...]:
    return folder / "sheet.png", "--camera", folder / "camera.toml", *arguments


def test_a_sheet_twice_as_far_is_twice_as_large(folder: Path) -> None:
    lines = run(*given(folder, *SHEET, "--at", "60in ± 1in", "--json")).stdout.splitlines()
    size = json.loads(lines[1])
    assert (size["width_m"], size["height_m"]) == pytest.approx((2 * 0.2794, 2 * 0.2159), rel=0.01)
    assert size["width_sigma_m"] / size["width_m"] == pytest.approx(1 / 60, rel=0.1)
    assert "22.0 in" in run(*given(folder, *SHEET, "--at", "60in")).stdout


def test_a_box_needs_no_target(folder: Path) -> None:
    size = json.loads(run(*given(folder, "--at", "762mm", "--box", "210,155,220,170", "--json")).stdout)
    assert (size["width_m"], size["height_m"]) == pytest.approx((0.2794, 0.2159), rel=0.01)
    assert "wide" in run(*given(folder, "--at", "762mm", "--box", "210,155,220,170")).stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--at", "0m", *SHEET), "--at: '0m' is not a length above zero"),
        (("--box", "1,2,3,4"), "add such as --at 2m"),
        (("--box", "600,2,90,4", "--at", "1m"), "reaches out of the picture"),
        (("--box", "1,2,3,4", "--at", "1m", *SHEET), "give one of them"),
        (
            ("--target", "ball diameter=6cm", "--target", "disc diameter=6cm", "--tolerance", "1mm"),
            "into each --target",
        ),
    ],
)
def test_what_makes_no_sense_is_said_with_the_option_and_what_to_do(
    folder: Path, arguments: tuple[str, ...], said: str
) -> None:
    result = run(*given(folder, *arguments))
    assert result.returncode == 2
    assert said in result.stderr


def test_two_targets_are_measured_and_how_far_they_are_apart_is_printed(folder: Path) -> None:
    image = cv2.imread(str(folder / "sheet.png"))
    cv2.circle(image, (560, 240), 40, (20, 20, 20), -1, cv2.LINE_AA)
    cv2.imwrite(str(folder / "sheet.png"), image)
    both = ("--target", "sheet width=11in height=8.5in", "--target", "disc diameter=101.6mm shade=dark")
    records = [json.loads(line) for line in run(*given(folder, *both, "--json")).stdout.splitlines()]
    assert [each.get("target") for each in records] == ["sheet", "disc", None]
    assert records[2]["between"] == ["sheet", "disc"]
    assert records[2]["distance_m"] == pytest.approx(240 / 600 * 0.762, rel=0.02)


def test_a_mounted_camera_gives_places_in_the_robot_s_frame(folder: Path) -> None:
    (folder / "run.toml").write_text(
        """
[camera]
driver = "images"
paths = ["sheet.png"]
model = "camera.toml"
height = "30 cm"
mount = { x = "10 cm", y = "2 cm" }

[targets.sheet]
detector = "sheet"
width = "11 in"
height = "8.5 in"
"""
    )
    found = json.loads(run(folder / "sheet.png", "--config", folder / "run.toml", "--json").stdout)
    place_m = [found[f"robot_{axis}_m"] for axis in "xyz"]
    assert place_m == pytest.approx([0.1 + found["z_m"], 0.02 - found["x_m"], 0.3 - found["y_m"]])
    assert "robot_x_m" not in json.loads(run(*given(folder, *SHEET, "--json")).stdout)
