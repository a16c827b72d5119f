"""The commands ``calibrate distance``, with pictures or before a camera, and ``calibrate check``."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.workbench.calibration.live_distance import FRAMES
from support.command_line import Typed, typed
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = pytest.mark.vision


# The command ``calibrate distance``.

SHEET = ("--sheet", "11in,8.5in")


def _picture(path: Path, width_px: int, height_px: int, centre: tuple[int, int] = (320, 240)) -> Path:
    image = np.full((480, 640, 3), (70, 100, 120), np.uint8)
    left, top = centre[0] - width_px // 2, centre[1] - height_px // 2
    cv2.rectangle(image, (left, top), (left + width_px - 1, top + height_px - 1), (230, 232, 228), -1)
    cv2.imwrite(str(path), image)
    return path


@pytest.fixture
def near(tmp_path: Path) -> Path:
    return _picture(tmp_path / "near.png", 220, 170)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "camera.toml"


def test_one_picture_is_enough(near: Path, output: Path) -> None:
    result = typed("calibrate", "distance", f"{near}@30in", *SHEET, "-o", output)
    assert result.returncode == 0
    assert result.stderr == ""
    first, second, third = result.stdout.splitlines()
    assert "220.0 x 170.0 px at 30.0 in" in first
    assert second.startswith("focal length 600.")
    assert second.endswith("for pictures of 640x480")
    assert third == f"wrote {output}"
    model = load_camera_model(output)
    assert model.fx_px == pytest.approx(600, rel=0.003)
    assert model.focal_relative_sigma == pytest.approx(0.01, abs=0.003)
    assert model.provenance.date
    assert str(near) in model.provenance.notes[0]
    again = typed("calibrate", "distance", f"{near}@30in", *SHEET, "-o", output, "--json")
    answer = json.loads(again.stdout)
    assert (answer["file"], answer["replaced"]) == (str(output), True)
    assert answer["camera_model"]["fx_px"] == answer["fit"]["focal_px"] == pytest.approx(model.fx_px)
    assert answer["pictures"][0]["picture"] == str(near)


def test_a_picture_whose_distance_is_mistyped_is_named_and_nothing_is_written(
    near: Path, output: Path, tmp_path: Path
) -> None:
    far = _picture(tmp_path / "far.png", 110, 85)
    again = _picture(near.with_name("again.png"), 220, 170)
    result = typed("calibrate", "distance", f"{near}@30in", f"{again}@30in", f"{far}@4.5ft", *SHEET, "-o", output)
    assert result.returncode == 2
    assert f"Most at odds with the others: {far}." in result.stderr
    assert not output.exists()


def test_a_file_that_is_there_is_replaced_and_that_is_said(near: Path, output: Path) -> None:
    output.write_text("old", encoding="utf-8")
    result = typed("calibrate", "distance", f"{near}@30in", *SHEET, "-o", output)
    assert result.stdout.splitlines()[-1] == f"replaced {output}"
    assert load_camera_model(output).fx_px == pytest.approx(600, rel=0.003)


def test_a_target_far_from_the_middle_is_noted(output: Path, tmp_path: Path) -> None:
    aside = _picture(tmp_path / "aside.png", 110, 85, (560, 60))
    result = typed("calibrate", "distance", f"{aside}@5ft", *SHEET, "-o", output)
    assert result.returncode == 0
    assert "the target is 27° from the middle of the picture" in result.stderr
    assert load_camera_model(output).focal_relative_sigma > 0.04
    checked = typed("calibrate", "check", f"{aside}@5ft", "--camera", output, *SHEET)
    assert "the target is 27° from the middle of the picture; 60.0 in was taken as its depth" in checked.stderr


def test_a_picture_without_the_target_is_left_out_and_exits_1(near: Path, output: Path, tmp_path: Path) -> None:
    wall = _picture(tmp_path / "wall.png", 1, 1)
    result = typed("calibrate", "distance", f"{near}@30in", f"{wall}@30in", *SHEET, "-o", output)
    assert result.returncode == 1
    assert result.stderr.startswith(f"left out: {wall}: ")
    assert load_camera_model(output).fx_px == pytest.approx(600, rel=0.003)


def test_a_picture_that_is_given_twice_is_refused_since_it_tells_nothing_more(near: Path, output: Path) -> None:
    for distances in (("30in", "30in"), ("30in", "60in")):
        result = typed("calibrate", "distance", *(f"{near}@{each}" for each in distances), *SHEET, "-o", output)
        assert result.returncode == 2
        assert f"{near} is given twice" in result.stderr
        assert not output.exists()


@pytest.mark.parametrize(
    ("distance", "said"),
    [
        ("", "does not say how far away the target is"),
        ("@24", "'24' has no unit"),
        ("@0in", "'0in' is not a length above zero"),
        ("@24 inchs", "unknown unit 'inchs'; did you mean"),
    ],
)
def test_a_bad_distance_is_one_line_and_exit_2(near: Path, output: Path, distance: str, said: str) -> None:
    result = typed("calibrate", "distance", f"{near}{distance}", *SHEET, "-o", output)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert said in line
    assert not output.exists()


def _turned_sheet(path: Path, tilt_rad: float, depth_m: float) -> Path:
    """Draw letter paper that is turned about its upright axis, through a lens of 600 px."""
    corners_m = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * (0.2794 / 2, 0.2159 / 2, 0)
    turn, _ = cv2.Rodrigues(np.array([0.0, tilt_rad, 0.0]))
    there = corners_m @ turn.T + (0, 0, depth_m)
    seen = there[:, :2] / there[:, 2:] * 600 + (319.5, 239.5)
    large = 4
    image = np.full((480 * large, 640 * large, 3), (70, 100, 120), np.uint8)
    outline = np.round(((seen + 0.5) * large - 0.5) * 256).astype(np.int32)
    cv2.fillConvexPoly(image, outline, (230, 232, 228), shift=8)
    cv2.imwrite(str(path), cv2.resize(image, (640, 480), interpolation=cv2.INTER_AREA))
    return path


def test_a_picture_that_measure_would_refuse_makes_no_camera_file(output: Path, tmp_path: Path) -> None:
    turned = _turned_sheet(tmp_path / "turned.png", 0.9, 0.4)
    right, wrong = (typed("calibrate", "distance", f"{turned}@{at}", *SHEET, "-o", output) for at in ("40cm", "90cm"))
    assert right.returncode == 0, right
    assert wrong.returncode == 1
    assert f"left out: {turned}: through the camera file it is not found: " in wrong.stderr
    assert "nothing was written" in wrong.stderr


# The command ``calibrate check``.


def _check(*arguments: object) -> Typed:
    return typed("calibrate", "check", *arguments)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """A sheet that is 30 in away at a focal length of 600 px."""
    image = np.full((480, 640, 3), (70, 100, 120), np.uint8)
    cv2.rectangle(image, (210, 155), (429, 324), (230, 232, 228), -1)
    cv2.imwrite(str(tmp_path / "sheet.png"), image)
    return tmp_path / "sheet.png"


def _camera_file(folder: Path, focal_px: float) -> Path:
    path = folder / "camera.toml"
    save_camera_model(path, CameraModel.with_focal_length(focal_px, 640, 480))
    return path


def test_a_right_camera_file_is_said_to_be_right(picture: Path, tmp_path: Path) -> None:
    result = _check(f"{picture}@30in", "--camera", _camera_file(tmp_path, 600), *SHEET)
    assert result.returncode == 0
    assert "instead of 30.0 in:" in result.stdout
    assert result.stdout.splitlines()[-1].endswith("is right within what it states")
    answer = json.loads(_check(f"{picture}@30in", "--camera", tmp_path / "camera.toml", *SHEET, "--json").stdout)
    assert answer["is_sound"]
    assert answer["pictures"][0]["depth_m"] == pytest.approx(0.762)


def test_a_wrong_camera_file_is_said_to_be_wrong_by_how_much_and_which_way(picture: Path, tmp_path: Path) -> None:
    result = _check(f"{picture}@30in", "--camera", _camera_file(tmp_path, 660), *SHEET)
    assert result.returncode == 1
    line, mean, verdict = result.stdout.splitlines()
    assert "+10." in line
    assert "σ  outside" in line
    assert mean.startswith("mean error +10.")
    assert "is wrong: it reads 10." in verdict
    assert "% too far" in verdict


def test_a_picture_of_another_aspect_than_the_camera_files_is_named(picture: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "wide.png"), cv2.imread(str(picture))[60:420])
    result = _check(f"{picture}@30in", f"{tmp_path / 'wide.png'}@30in", "--camera", _camera_file(tmp_path, 600), *SHEET)
    assert result.returncode == 2
    assert "wide.png: the camera was calibrated at 640x480; a picture of 640x360 has another aspect" in result.stderr


# `calibrate distance --live`, with pictures for a camera: each distance takes the next nine of them.

BALL = ("--ball", "20cm", "--hsv", "20,60,40:50,255,255")


@cache
def _ball_at(near_side_m: float, focal_px: float = 600.0) -> Image:
    lens = CameraModel.with_focal_length(focal_px, 640, 480)
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    return render(Scene(camera=lens, target=ball, seed=1, backdrop=PlainBackdrop())).image


def _run_live(folder: Path, images: list[Image], answers: str, *options: str) -> Typed:
    for number, image in enumerate(images):
        for frame in range(FRAMES):
            cv2.imwrite(str(folder / f"{number}-{frame}.png"), image)
    config = folder / "room.toml"
    config.write_text(f'[camera]\ndriver = "images"\npaths = ["{folder}/*.png"]\nrate = "10 Hz"\n')
    output = folder / "camera.toml"
    return typed("calibrate", "distance", "--live", config, *BALL, "-o", output, *options, answers=answers)


@pytest.mark.long
def test_two_distances_asked_for_and_proved_give_a_camera_file(tmp_path: Path) -> None:
    result = _run_live(tmp_path, [_ball_at(1.0), _ball_at(3.0)], "\n\n")
    assert result.returncode == 0, result
    lines = result.stdout.splitlines()
    assert lines[0].startswith("Measure with a tape, from the lens to the nearest point of the ball.")
    assert [line for line in lines if line.endswith((" 1 m.", " 3 m."))] == ["Put it at 1 m.", "Now put it at 3 m."]
    assert re.search(r"at 3 m: found in 9 of 9 frames, \d+ px, spread 0\.0%\n", result.stdout)
    assert lines[-1] == f"wrote {tmp_path / 'camera.toml'}"
    model = load_camera_model(tmp_path / "camera.toml")
    assert model.fx_px == pytest.approx(600, rel=0.01)
    assert "at 3 m" in model.provenance.notes[1]


@pytest.mark.long
def test_the_distance_that_it_really_has_can_be_typed_and_a_wrong_unit_is_asked_again(tmp_path: Path) -> None:
    result = _run_live(tmp_path, [_ball_at(1.0), _ball_at(2.5)], "\n3 apples\n2.5m\n", "--at", "1m", "--at", "2m")
    assert result.returncode == 0, result
    assert "error: the distance: '3 apples'" in result.stderr
    assert result.stdout.count("Now put it at 2m.") == 2
    assert "at 2.5m" in load_camera_model(tmp_path / "camera.toml").provenance.notes[1]


def test_without_an_answer_nothing_is_written(tmp_path: Path) -> None:
    result = _run_live(tmp_path, [_ball_at(1.0), _ball_at(3.0)], "\n")
    assert result.returncode == 1
    assert "there is no answer, so nothing was written" in result.stderr
    assert not (tmp_path / "camera.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--live", "opencv,device=0", "--at", "1m"), "give two, such as --at 1m --at 3m"),
        (("--live", "opencv,device=947"), "there is no camera /dev/video947"),
        (("--live", "opencv,device=0", "-o", "nowhere/camera.toml"), "-o: there is no folder nowhere"),
        (("near.png@1m", "--live", "opencv,device=0"), "one of the two"),
    ],
)
def test_what_cannot_work_is_one_line(tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    output = str(tmp_path / "camera.toml")
    result = typed("calibrate", "distance", "-o", output, *arguments, *BALL)
    assert result.returncode == 2
    (error,) = [line for line in result.stderr.splitlines() if line.startswith("error")]
    assert words in error
