"""Drawings of calibration boards, exactly as `stadimeter.workbench.calibration.board_session` finds them."""

from __future__ import annotations

import cv2
import numpy as np

from stadimeter.core.drawing import Drawing, Shape, black_cells
from stadimeter.workbench.calibration.board_session import Board, CharucoBoard, Chessboard


def board_drawing(board: Board) -> Drawing:
    """Return a board; a chessboard begins with a black square, and so does a ChArUco board."""
    return _charuco(board) if isinstance(board, CharucoBoard) else _chessboard(board)


def _chessboard(board: Chessboard) -> Drawing:
    return _squares(board.columns + 1, board.rows + 1, board.square_m)


def _squares(columns: int, rows: int, square_m: float) -> Drawing:
    black = [[(row + column) % 2 == 0 for column in range(columns)] for row in range(rows)]
    return black_cells(black, square_m)


def _charuco(board: CharucoBoard) -> Drawing:
    """Return the squares, and the markers where OpenCV's own board has them."""
    of_opencv = board.of_opencv()
    dictionary = of_opencv.getDictionary()
    squares = _squares(board.columns, board.rows, board.square_m)
    shapes: list[Shape] = [*squares.shapes]
    corners_m = np.asarray(of_opencv.getObjPoints(), np.float64)[:, 0, :2]
    for number, (x_m, y_m) in zip(np.ravel(of_opencv.getIds()), corners_m, strict=True):
        cells = int(dictionary.markerSize) + 2
        black = np.asarray(cv2.aruco.generateImageMarker(dictionary, int(number), cells)) == 0
        shapes += black_cells(black.tolist(), board.marker_m / cells).moved(float(x_m), float(y_m))
    return Drawing(squares.width_m, squares.height_m, tuple(shapes))
