"""The commands ``calibrate board`` and ``calibrate floor``."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError
from stadimeter.workbench import frame_source
from stadimeter.workbench.frame_source import SETTLING_FRAMES, Source
from support.command_line import Typed, typed
from support.scenes.draw import CAMERA, TAG_M
from support.scenes.on_floor import ball_on_floor, tag_lying
from support.scenes.render import render

# The command ``calibrate board``.

BOARD = ("--board", "9x6", "--square", "25mm")
MATRIX = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])


def _run(*arguments: object) -> Typed:
    return typed("calibrate", "board", *arguments)


def _picture(path: Path, turn: tuple[float, float, float], place_m: tuple[float, float, float]) -> Path:
    """Draw a chessboard through a pinhole of 600 px."""
    squares = np.where(np.indices((7, 10)).sum(axis=0) % 2 == 0, 30, 225)
    board = cv2.copyMakeBorder(np.kron(squares, np.ones((40, 40))).astype(np.uint8), 40, 40, 40, 40, 0, value=225)
    to_m = np.array([[0.025 / 40, 0, -0.15 + 0.0003125], [0, 0.025 / 40, -0.1125 + 0.0003125], [0, 0, 1]])
    rotation, _ = cv2.Rodrigues(np.array(turn))
    pose = np.column_stack((rotation[:, :2], place_m))
    image = cv2.warpPerspective(board, MATRIX @ pose @ to_m, (640, 480), flags=cv2.INTER_AREA, borderValue=120)
    cv2.imwrite(str(path), cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), 0.7), cv2.COLOR_GRAY2BGR))
    return path


@pytest.fixture
def pictures(tmp_path: Path) -> list[Path]:
    turns = [(0.6, 0, 0), (-0.6, 0, 0.1), (0, 0.6, 0), (0, -0.6, 0.2), (0.4, 0.4, 0), (-0.4, 0.4, 0), (0.4, -0.4, 0.1)]
    places = [(0, 0, 0.4), (0.03, 0.02, 0.4), (-0.05, 0.02, 0.42), (0.05, -0.03, 0.42), (0, 0.03, 0.4)]
    return [_picture(tmp_path / f"board{i}.png", turn, places[i % len(places)]) for i, turn in enumerate(turns)]


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "camera.toml"


def test_the_camera_file_is_written_and_told(pictures: list[Path], output: Path) -> None:
    result = _run(*pictures, *BOARD, "-o", output)
    assert result.returncode == 0, result
    lines = result.stdout.splitlines()
    assert all(" 54 corners, error 0." in line for line in lines[:7])
    assert "over 7 pictures, with corners in" in lines[7]
    assert lines[8].startswith("focal length ")
    assert lines[9] == f"wrote {output}"
    model = load_camera_model(output)
    assert model.fx_px == pytest.approx(600, rel=0.01)
    assert len(model.distortion) == 5
    assert 0 < model.focal_relative_sigma < 0.02


def test_a_picture_without_the_board_is_left_out_and_exits_1(
    pictures: list[Path], output: Path, tmp_path: Path
) -> None:
    wall = tmp_path / "wall.png"
    cv2.imwrite(str(wall), np.full((480, 640, 3), 90, np.uint8))
    result = _run(*pictures, wall, *BOARD, "-o", output, "--json")
    assert result.returncode == 1
    answer = json.loads(result.stdout)
    assert (answer["file"], len(answer["views"])) == (str(output), len(pictures))
    assert f"left out: {wall}: no chessboard of 9x6 inner corners" in result.stderr
    assert output.exists()


def test_too_few_pictures_exit_2(pictures: list[Path], output: Path) -> None:
    result = _run(*pictures[:2], *BOARD, "-o", output)
    assert result.returncode == 2
    assert "found in 2 different views; a calibration needs 3 at least" in result.stderr


def test_a_board_that_always_faces_the_camera_writes_nothing_and_says_to_tilt_it(output: Path, tmp_path: Path) -> None:
    places = [(0, 0, 0.4), (0.05, 0.03, 0.4), (-0.05, 0.03, 0.45), (0.05, -0.04, 0.5), (-0.05, -0.04, 0.42)]
    facing = [_picture(tmp_path / f"{i}.png", (0, 0, 0.02 * i), place) for i, place in enumerate(places)]
    result = _run(*facing, *BOARD, "-o", output)
    assert result.returncode == 2
    assert not output.exists()
    (line,) = result.stderr.splitlines()
    assert "do not tell the focal length" in line
    assert "tilt the board by 30 to 45 degrees" in line


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--board", "9x6", "--charuco", "5x7", "--square", "25mm"), "say which board it is"),
        (("--board", "9by6", "--square", "25mm"), "'9by6' is no size of a board"),
        (("--board", "2x6", "--square", "25mm"), "3 at least"),
        (("--charuco", "5x7", "--square", "40mm"), "--charuco needs --marker LENGTH and --dictionary NAME"),
        (
            ("--charuco", "5x7", "--square", "40mm", "--marker", "20mm", "--dictionary", "nine"),
            "there is no marker dictionary 'nine'",
        ),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_2(
    pictures: list[Path], output: Path, options: tuple[str, ...], said: str
) -> None:
    result = _run(pictures[0], *options, "-o", output)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert said in line
    assert not output.exists()


class Held:
    """A live camera before which somebody holds a board: each picture for a few frames, then another."""

    def __init__(self, pictures: list[Path], ending: BaseException, frames_each: int = 3) -> None:
        images = [cv2.imread(str(picture)) for picture in pictures]
        self._images = [image for image in images for _ in range(frames_each)]
        self._ending, self._settling = ending, SETTLING_FRAMES
        self._count = 0
        self.is_open = False

    def open(self) -> None:
        self.is_open = True

    def latest(self, timeout_s: float) -> Frame:
        assert self.is_open
        if self._settling:
            self._settling -= 1
            return Frame(self._images[0], 0.0, 0)
        if self._count == 2:
            self._count += 1
            raise CaptureTimeoutError("no new frame in 0.50 s")
        if not self._images:
            raise self._ending
        self._count += 1
        return Frame(self._images.pop(0), self._count / 30, self._count)

    def remarks(self) -> tuple[str, ...]:
        return ("the camera did not take the focus",)

    def trouble(self) -> str:
        return ""

    def close(self) -> None:
        self.is_open = False


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Held]:
    """Return a function that puts a live camera in place of the one that is named."""

    def make(pictures: list[Path], ending: BaseException) -> Held:
        camera = Held(pictures, ending)
        monkeypatch.setattr(frame_source, "open_source", lambda _: Source(capture=camera, is_live=True))
        return camera

    return make


def test_a_live_camera_is_calibrated_from_what_it_saw_until_ctrl_c(
    pictures: list[Path], output: Path, held: Callable[..., Held]
) -> None:
    camera = held(pictures, KeyboardInterrupt())
    result = _run("--live", "opencv,device=0", *BOARD, "-o", output)
    assert result.returncode == 0, result
    lines = result.stdout.splitlines()
    assert lines[0].startswith("move the board about")
    told = [line for line in lines if line.startswith("view ")]
    assert told[0] == "view 1  54 corners"
    assert re.match(r"view 7  54 corners, error 0\.\d\d px; focal length 6\d\d px ± \d\.\d%, corners in \d\d%", told[6])
    assert any("still missing: the board in the " in line for line in lines)
    assert "note: the camera did not take the focus" in result.stderr
    assert "stopped with 7 views" in result.stderr
    assert load_camera_model(output).fx_px == pytest.approx(600, rel=0.01)
    assert not camera.is_open


def test_a_camera_that_is_lost_is_closed_and_told(
    pictures: list[Path], output: Path, held: Callable[..., Held]
) -> None:
    camera = held(pictures[:1], DeviceClosedError("the camera is gone"))
    result = _run("--live", "opencv,device=0", *BOARD, "-o", output)
    assert result.returncode == 2
    assert "error: the camera is gone" in result.stderr
    assert not camera.is_open


def test_the_camera_of_a_configuration_is_taken_though_its_camera_file_is_not_there_yet(
    pictures: list[Path], output: Path, tmp_path: Path
) -> None:
    wall = tmp_path / "board9.png"
    cv2.imwrite(str(wall), np.full((480, 640, 3), 90, np.uint8))
    config = tmp_path / "run.toml"
    config.write_text(
        '[camera]\ndriver = "images"\npaths = "board*.png"\nmodel = "camera.toml"\n[targets.nonsense]\n',
        encoding="utf-8",
    )
    result = _run("--live", config, *BOARD, "-o", output)
    assert result.returncode == 0, result
    assert f"left out: {wall}: no chessboard" in result.stderr
    assert result.stdout.count(" 54 corners, error ") >= 7
    assert load_camera_model(output).fx_px == pytest.approx(600, rel=0.01)


def test_pictures_and_a_camera_exclude_each_other(pictures: list[Path], output: Path) -> None:
    for arguments in ((), (*pictures, "--live", "opencv")):
        result = _run(*arguments, *BOARD, "-o", output)
        assert result.returncode == 2
        assert "give pictures of the board, or --live for a camera" in result.stderr


# The command ``calibrate floor``, and what `measure` makes of the lines that it prints.

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
    paths = [name if name.startswith("--") else folder / name for name in pictures]
    return typed("calibrate", "floor", *paths, "--camera", folder / "camera.toml", *TAG)


def test_a_tag_on_the_floor_gives_the_lines_for_the_camera(folder: Path) -> None:
    result = calibrate(folder, "tag.png")
    assert result.returncode == 0
    found = re.search(
        r'\[camera\]\nheight = "([\d.]+) cm ± ([\d.]+) mm"\ntilt = "(-[\d.]+) deg ± ([\d.]+) deg"', result.stdout
    )
    assert found is not None
    height_cm, off_mm, tilt_deg, off_deg = map(float, found.groups())
    answer = json.loads(calibrate(folder, "tag.png", "--json").stdout)
    assert answer["height_m"] == answer["pictures"][0]["height_m"] == pytest.approx(height_cm / 100, abs=1e-4)
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
