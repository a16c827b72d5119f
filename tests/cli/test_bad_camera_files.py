"""Camera files and calibrations that cannot be right: one line that says why, and nothing is measured or written."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from support.command_line import typed

GOOD = "width_px = 640\nheight_px = 480\nfx_px = 600.0\n"
SHEET = ("--sheet", "11in,8.5in")


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    image = np.full((480, 640, 3), 60, np.uint8)
    image[155:325, 210:430] = 230
    cv2.imwrite(str(tmp_path / "near.png"), image)
    return tmp_path / "near.png"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GOOD + "fy_px = nan\n", ":4: fy_px: nan is not a finite number"),
        (GOOD + "edge_bias_px = 100.0\n", ":4: edge_bias_px: 100.0 is above 5"),
        (GOOD + 'tone_curve = "lineer"\n', "did you mean 'linear'"),
        (GOOD + "distortion = [-0.9, 0.0, 0.0, 0.0]\n", "folds the picture before its corner at 0, 0 px"),
        (GOOD + "distortion = [1e9, 0.0, 0.0, 0.0]\n", "has a coefficient that no lens has"),
        (GOOD + "zoom = 2\n", ":4: zoom: unknown key 'zoom'"),
        (GOOD.replace("640", "0"), ":1: width_px: 0 is not above 0"),
        (GOOD.replace("600.0", "4.12"), "focal length fx_px = 4.12 is not that of a lens"),
        (GOOD.replace("600.0", "1e17"), "focal length fx_px = 1e+17 is not that of a lens"),
    ],
)
def test_a_camera_file_that_cannot_be_right_is_one_line(picture: Path, tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(text, encoding="utf-8")
    result = typed("measure", picture, "--camera", file, *SHEET)
    assert result.returncode == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"error: {file}")
    assert said in line


def test_the_shortest_lenses_and_long_telescopes_are_cameras_too(picture: Path, tmp_path: Path) -> None:
    file = tmp_path / "camera.toml"
    for focal_px in ("20.0", "600000.0"):
        file.write_text(GOOD.replace("600.0", focal_px), encoding="utf-8")
        assert typed("measure", picture, "--camera", file, *SHEET).returncode < 2


def test_a_picture_that_is_given_twice_is_refused_since_it_tells_nothing_more(picture: Path, tmp_path: Path) -> None:
    output = tmp_path / "camera.toml"
    for distances in (("30in", "30in"), ("30in", "60in")):
        given = [f"{picture}@{distance}" for distance in distances]
        result = typed("calibrate", "distance", *given, *SHEET, "-o", output)
        assert result.returncode == 2
        assert f"{picture} is given twice" in result.stderr
        assert not output.exists()


@pytest.mark.parametrize("distance", ["1mm", "10000km"])
def test_a_distance_that_no_lens_explains_writes_nothing(picture: Path, tmp_path: Path, distance: str) -> None:
    output = tmp_path / "camera.toml"
    result = typed("calibrate", "distance", f"{picture}@{distance}", *SHEET, "-o", output)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert "is not that of a lens" in line
    assert "check its unit, or the distance" in line
    assert not output.exists()
