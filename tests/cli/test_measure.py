"""The command ``measure``, as a person and as a program use it."""

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

KEYS = [
    "file", "target", "status", "perhaps", "distance_m", "depth_m", "sigma_m", "bearing_rad", "elevation_rad",
    "tilt_rad", "ambiguity", "reason", "x_m", "y_m", "z_m", "bearing_sigma_rad", "elevation_sigma_rad", "outline_px",
    "id", "frame", "time_s",
]  # fmt: skip
SHEET = ("--sheet", "11in,8.5in")
BALL = ("--ball", "10cm", "--hsv", "170,100,60:10,255,255")


def _run(*arguments: object) -> Typed:
    return typed("measure", *arguments)


@pytest.fixture
def camera(tmp_path: Path) -> tuple[str, str]:
    save_camera_model(tmp_path / "camera.toml", CameraModel.with_focal_length(600.0, 640, 480))
    return "--camera", str(tmp_path / "camera.toml")


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    folder = tmp_path / "pictures"
    folder.mkdir()
    wall = np.full((480, 640, 3), (70, 100, 120), np.uint8)
    sheet, ball, cut = wall.copy(), wall.copy(), wall.copy()
    cv2.rectangle(sheet, (210, 155), (429, 324), (230, 232, 228), -1)
    cv2.circle(ball, (320, 240), 30, (40, 30, 200), -1, cv2.LINE_AA)
    cv2.circle(cut, (10, 240), 30, (40, 30, 200), -1, cv2.LINE_AA)
    for name, image in (("sheet", sheet), ("ball", ball), ("cut", cut), ("wall", wall)):
        cv2.imwrite(str(folder / f"{name}.png"), image)
    return folder


def test_a_sheet_is_measured_in_the_persons_unit_and_in_metres(pictures: Path, camera) -> None:
    result = _run(pictures / "sheet.png", *camera, *SHEET)
    assert result.returncode == 0
    assert result.stderr == ""
    (line,) = result.stdout.splitlines()
    # 0.2794 m * 600 px / 220 px = 0.762 m = 30 in
    assert line.startswith(f"{pictures / 'sheet.png'}  sheet  30.0")
    assert " in ± 0." in line
    assert " 0.762 m ± 0.00" in line
    assert re.search(r" ahead +(face on|tilted [1-5]°)$", line)


def test_json_is_one_object_a_line_with_exactly_these_keys(pictures: Path, camera) -> None:
    result = _run(pictures / "ball.png", pictures / "cut.png", pictures / "wall.png", *camera, *BALL, "--json")
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [list(record) for record in records] == [KEYS] * 3
    assert [record["status"] for record in records] == ["measured", "truncated", "not_found"]
    assert records[0]["distance_m"] == pytest.approx(1.0, rel=0.03)
    assert records[0]["reason"] == ""
    for record in records[1:]:
        assert record["distance_m"] is record["depth_m"] is record["sigma_m"] is record["bearing_rad"] is None
        assert record["reason"]
    assert result.returncode == 1


def test_a_bad_picture_is_one_line_on_stderr_and_the_good_ones_are_still_measured(pictures: Path, camera) -> None:
    (pictures / "empty.png").touch()
    (pictures / "cut-short.png").write_bytes((pictures / "ball.png").read_bytes()[:300])
    bad = ["missing.png", "empty.png", "cut-short.png"]
    names = [bad[0], "ball.png", bad[1], bad[2]]
    result = _run(*(pictures / name for name in names), pictures, *camera, *BALL)
    assert result.returncode == 2
    assert len(result.stdout.splitlines()) == 1
    lines = result.stderr.splitlines()
    assert len(lines) == 4
    for line, name in zip(lines, [*bad, ""], strict=True):
        assert line.startswith("error: ")
        assert line.count(str(pictures / name)) == 1


def test_a_bad_picture_in_json_has_the_status_error(pictures: Path, camera) -> None:
    result = _run(pictures / "missing.png", pictures / "ball.png", *camera, *BALL, "--json")
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [record["status"] for record in records] == ["error", "measured"]
    assert "there is no such file" in records[0]["reason"]
    assert result.returncode == 2


def test_annotated_copies_are_written_beside_nothing_else(pictures: Path, camera, tmp_path: Path) -> None:
    result = _run(pictures / "ball.png", pictures / "wall.png", *camera, *BALL, "--annotate", tmp_path / "new" / "out")
    assert result.returncode == 1
    assert sorted(file.name for file in (tmp_path / "new" / "out").iterdir()) == [
        "ball-measured.png",
        "wall-measured.png",
    ]
    copy = cv2.imread(str(tmp_path / "new" / "out" / "ball-measured.png"))
    assert (copy != cv2.imread(str(pictures / "ball.png"))).any()


def test_copies_in_the_pictures_own_folder_leave_the_pictures_alone(pictures: Path, camera) -> None:
    before = (pictures / "ball.png").read_bytes()
    _run(pictures / "ball.png", *camera, *BALL, "--annotate", pictures)
    assert (pictures / "ball.png").read_bytes() == before
    assert (pictures / "ball-measured.png").exists()


def test_a_configuration_says_what_to_look_for_and_through_which_camera(pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(
        """
        [camera]
        driver = "opencv"
        device = 0
        model = { width_px = 640, height_px = 480, fx_px = 600.0 }
        [targets.red]
        detector = "ball"
        diameter = "10 cm"
        hsv = "170,100,60:10,255,255"
        [targets.paper]
        detector = "sheet"
        width = "11 in"
        height = "8.5 in"
        """,
        encoding="utf-8",
    )
    result = _run(pictures / "ball.png", "--config", tmp_path / "two.toml", "--json")
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(record["target"], record["status"]) for record in records] == [("red", "measured"), ("paper", "not_found")]
    assert result.returncode == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--sheet", "0in,8in"), "--sheet: '0in' is not a length above zero"),
        (("--sheet", "11,8.5"), "is not a width and a height"),
        (("--ball", "6cm", "--hsv", "1,2,3:4,5,600"), "value 600 is outside 0 to 255"),
        ((), "nothing says what to look for"),
        (("--config", "missing.toml"), "missing.toml: there is no such file"),
    ],
)
def test_a_bad_option_is_one_line_and_exit_2(pictures: Path, camera, arguments, said: str) -> None:
    result = _run(pictures / "ball.png", *camera, *arguments)
    assert result.returncode == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert said in line


def test_no_camera_file_says_how_to_make_one(pictures: Path) -> None:
    result = _run(pictures / "ball.png", *BALL)
    assert result.returncode == 2
    assert "--camera: the camera file is missing" in result.stderr
    assert "calibrate distance" in result.stderr


def test_a_broken_camera_file_is_named_with_its_line(pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text("width_px = 640\nheight_px = -480\nfx_px = 600\n", encoding="utf-8")
    result = _run(pictures / "ball.png", "--camera", tmp_path / "camera.toml", *BALL)
    assert result.returncode == 2
    assert result.stderr.startswith(f"error: {tmp_path / 'camera.toml'}:2: height_px: -480 is not above 0")


def test_all_options_that_are_missing_are_named_at_once(pictures: Path) -> None:
    result = _run(pictures / "ball.png", "--tag", "10cm")
    assert result.returncode == 2
    assert "add --family" in result.stderr
    assert "--camera: the camera file is missing" in result.stderr
