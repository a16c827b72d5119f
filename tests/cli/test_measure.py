"""The command ``measure``, as a person and as a program use it."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.cli.formatting import FOOT, METRE
from stadimeter.cli.measure import Printer, explanation, explanation_record, marks_of
from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, RejectedCandidate
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.ranging.measure import SigmaParts
from stadimeter.workbench.measuring import PictureResult, TargetResult
from support.command_line import Typed, typed

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


def test_what_is_missing_is_named(pictures: Path) -> None:
    for options, words in ((), "nothing says what to look for"), (BALL, "--camera: the camera file is missing"):
        result = _run(pictures / "ball.png", *options)
        assert result.returncode == 2
        assert words in result.stderr


# What ``measure --explain`` says.

DOOR = RejectedCandidate(centre_px=(120.4, 340.0), size_px=88.2, reason="edge scatters by 2.1 px, limit 1.0 px")
LAMP = RejectedCandidate(centre_px=(9.0, 8.0), size_px=7.0, reason="7.0 px wide, limit 12 px")

MEASURED = Measurement(
    target="paper",
    status=MeasurementStatus.MEASURED,
    captured_at_s=0.0,
    distance_m=2.0,
    depth_m=2.0,
    sigma_m=0.025,
    noise_m=0.0006,
    bearing_rad=0.0,
    elevation_rad=0.0,
    tilt_rad=math.radians(14),
    ambiguity=0.12,
)
FOUND = Detection(
    target="paper",
    status=DetectionStatus.FOUND,
    outline_px=np.array([(210.0, 155.0), (429.0, 155.0), (429.0, 324.0), (210.0, 324.0)]),
    centre_px=(319.5, 239.5),
    width_px=219.0,
    height_px=169.0,
    size_sigma_px=0.043,
    quality=0.98,
)
PARTS = SigmaParts(edges_m=0.0006, focal_length_m=0.024, size_m=0.0, pose_m=0.007)


def result(
    measured: Measurement = MEASURED, found: Detection | None = FOUND, parts: SigmaParts | None = PARTS, first: int = 1
) -> TargetResult:
    return TargetResult(file="a.png", measurement=measured, detection=found, parts=parts, rejected_from=first)


def not_found(*rejected: RejectedCandidate) -> TargetResult:
    reason = "no sheet among 2 outlines"
    return result(
        Measurement(target="paper", status=MeasurementStatus.NOT_FOUND, captured_at_s=0.0, reason=reason),
        Detection(target="paper", status=DetectionStatus.NOT_FOUND, reason=reason, rejected=rejected),
        None,
    )


def test_a_target_that_was_found_is_explained_line_by_line() -> None:
    assert explanation(result(found=replace(FOUND, rejected=(DOOR, LAMP)), first=9)) == [
        "    seen       219.00 x 169.00 px ± 0.04 at 319.5, 239.5, quality 0.98",
        "    tilt       tilted 14°, ambiguity 0.12",
        (
            "    sigma      1.25 % of the distance: edges 0.030 %, focal length 1.20 %, size taken as exact, "
            "which way it is tilted 0.35 %"
        ),
        "    rejected    9  88 px at 120, 340  edge scatters by 2.1 px, limit 1.0 px",
        "               10  7 px at 9, 8       7.0 px wide, limit 12 px",
    ]


def test_what_is_perhaps_the_target_has_its_distance_and_the_doubt_in_one_line(capsys: Any) -> None:
    doubted = result(replace(MEASURED, status=MeasurementStatus.PERHAPS, reason="a pale rim"))
    doubted = replace(doubted, detection=replace(FOUND, status=DetectionStatus.PERHAPS, reason="a pale rim"))
    printer = Printer(as_json=False, explain=False, unit=FOOT, file_width=5, target_width=5)
    printer.result(doubted)
    assert capsys.readouterr().out == "a.png  paper  perhaps 6.56 ft ± 0.08  2.00 m ± 0.03: a pale rim\n"
    (mark,) = marks_of(PictureResult(file="a.png", frame=None, targets=(doubted,)), METRE)
    assert mark.headline == "paper: perhaps 2.00 m ± 0.03"
    assert mark.lines[-1] == "perhaps: a pale rim"


def test_json_has_the_outline_and_says_what_is_only_perhaps_the_target() -> None:
    assert result().record()["perhaps"] is False
    record = result(replace(MEASURED, status=MeasurementStatus.PERHAPS)).record()
    assert (record["status"], record["perhaps"]) == ("measured", True)
    assert record["outline_px"] == [[210.0, 155.0], [429.0, 155.0], [429.0, 324.0], [210.0, 324.0]]
    assert json.loads(json.dumps(not_found().record()))["outline_px"] == []


def test_a_picture_in_which_nothing_was_looked_at_says_so() -> None:
    assert explanation(not_found()) == ["    rejected   nothing was looked at"]
    assert explanation(result())[-1] == "    rejected   nothing else was looked at"


def test_the_fields_for_programs_say_the_same() -> None:
    record = explanation_record(result(found=replace(FOUND, rejected=(DOOR,)), first=4))
    assert json.loads(json.dumps(record)) == {
        "remark": "",
        "centre_px": [319.5, 239.5],
        "width_px": 219.0,
        "height_px": 169.0,
        "size_sigma_px": 0.043,
        "quality": 0.98,
        "sigma_edges_m": 0.0006,
        "sigma_focal_length_m": 0.024,
        "sigma_size_m": 0.0,
        "sigma_pose_m": 0.007,
        "floor_distance_m": None,
        "floor_sigma_m": None,
        "floor_apart_sigmas": None,
        "rejected": [{"number": 4, "centre_px": [120.4, 340.0], "size_px": 88.2, "reason": DOOR.reason}],
    }


# ``measure --at``, two targets, and the robot's frame.


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
        (("--box", "1,2,3,4", "--at", "1m", *SHEET), "leave out --sheet"),
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
