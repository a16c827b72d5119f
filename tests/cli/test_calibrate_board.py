"""The command ``calibrate board``."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli.main import app
from stadimeter.config.camera_file import load_camera_model

BOARD = ("--board", "9x6", "--square", "25mm")
MATRIX = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])


def _run(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["calibrate", "board", *map(str, arguments)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


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
    assert result.exit_code == 0, result.output
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
    result = _run(*pictures, wall, *BOARD, "-o", output)
    assert result.exit_code == 1
    assert f"left out: {wall}: no chessboard of 9x6 inner corners" in result.stderr
    assert output.exists()


def test_a_board_that_is_never_found_says_what_to_look_at_and_writes_nothing(
    pictures: list[Path], output: Path
) -> None:
    result = _run(*pictures[:2], "--board", "8x5", "--square", "25mm", "-o", output)
    assert result.exit_code == 1
    assert "found in no picture, so nothing was written; count its inner corners again" in result.stderr
    assert not output.exists()


def test_too_few_pictures_exit_2(pictures: list[Path], output: Path) -> None:
    result = _run(*pictures[:2], *BOARD, "-o", output)
    assert result.exit_code == 2
    assert "found in 2 different views; a calibration needs 3 at least" in result.stderr


def test_pictures_of_two_resolutions_are_refused(pictures: list[Path], output: Path, tmp_path: Path) -> None:
    large = tmp_path / "large.png"
    cv2.imwrite(str(large), cv2.resize(cv2.imread(str(pictures[0])), (1280, 960)))
    result = _run(*pictures, large, *BOARD, "-o", output)
    assert result.exit_code == 2
    assert f"{large} has 1280x960" in result.stderr


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--square", "25mm"), "say which board it is"),
        (("--board", "9x6", "--charuco", "5x7", "--square", "25mm"), "say which board it is"),
        (("--board", "9by6", "--square", "25mm"), "'9by6' is no size of a board"),
        (("--board", "2x6", "--square", "25mm"), "3 at least"),
        (("--board", "9x6", "--square", "25"), "'25' has no unit"),
        (("--board", "9x6", "--square", "25mm", "--marker", "10mm"), "describe a ChArUco board"),
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
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert said in line
    assert not output.exists()
