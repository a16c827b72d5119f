"""Boards are found in pictures, and their corners placed well enough to calibrate from."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import BoardView
from stadimeter.workbench.calibration.board_session import CharucoBoard, Chessboard

BOARD = Chessboard(columns=9, rows=6, square_m=0.025)
CHARUCO = CharucoBoard(columns=5, rows=7, square_m=0.04, marker_m=0.02, dictionary="6X6_250")


def drawn(square_px: int = 40) -> Image:
    """A chessboard of 10x7 squares on white, facing the camera; its first inner corner is at (2, 2) squares."""
    squares = np.indices((7, 10)).sum(axis=0) % 2
    board = np.kron(np.where(squares == 0, 30, 225), np.ones((square_px, square_px)))
    framed = cv2.copyMakeBorder(board.astype(np.uint8), *([square_px] * 4), cv2.BORDER_CONSTANT, value=225)
    return cv2.cvtColor(cv2.GaussianBlur(framed, (0, 0), 1.0), cv2.COLOR_GRAY2BGR)


@pytest.mark.parametrize("square_px", [12, 40, 250])
def test_the_corners_are_where_they_were_drawn(square_px: int) -> None:
    found = BOARD.find("a.png", drawn(square_px))
    assert isinstance(found, BoardView)
    expected = (np.stack(np.meshgrid(np.arange(9), np.arange(6)), axis=2).reshape(-1, 2) + 2) * square_px - 0.5
    sorted_px = found.corners_px[np.lexsort(np.round(found.corners_px / square_px).T)]
    assert sorted_px == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("board", [BOARD, CHARUCO])
@pytest.mark.parametrize("shape", [(1, 1, 3), (480, 640, 3)])
def test_a_picture_without_the_board_gives_the_reason(board: Chessboard | CharucoBoard, shape: tuple[int, ...]) -> None:
    reason = board.find("a.png", np.full(shape, 128, np.uint8))
    assert isinstance(reason, str)
    assert "9x6 inner corners" in reason or "0 of 24 corners of the ChArUco board" in reason


def test_a_charuco_board_may_be_partly_hidden() -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    image = cv2.aruco.CharucoBoard((5, 7), 0.04, 0.02, dictionary).generateImage((500, 700), marginSize=20)
    image[:, 300:] = 200
    found = CHARUCO.find("a.png", cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    assert isinstance(found, BoardView)
    assert 6 <= len(found.corners_px) < 24
    image[:, 120:] = 200
    assert "corners of the ChArUco board" in str(CHARUCO.find("a.png", cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)))


def test_a_marker_larger_than_its_square_and_an_unknown_dictionary_are_refused() -> None:
    with pytest.raises(CalibrationError, match="does not fit into a square"):
        CharucoBoard(columns=5, rows=7, square_m=0.02, marker_m=0.04, dictionary="4X4_50")
    with pytest.raises(CalibrationError, match=r"there is no marker dictionary '4X5_50'; there are .*4X4_50"):
        CharucoBoard(columns=5, rows=7, square_m=0.04, marker_m=0.02, dictionary="4X5_50")
