"""Corners of rendered chessboards, sharp and blurred, against where they are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stadimeter.ranging.board_calibration import BoardView, calibrate_board
from stadimeter.workbench.calibration.board_session import Chessboard, scatter_px

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

COLUMNS, ROWS, SQUARE_M = 9, 6, 0.025
FOCAL_PX, CENTRE_PX = 612.0, np.array((319.5, 239.5))
LARGE = 3
BOARD = Chessboard(columns=COLUMNS, rows=ROWS, square_m=SQUARE_M)
INNER = np.column_stack([axis.ravel() for axis in np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))])


def place(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the homography of a tilted board that is seen whole, from squares to pixels, and its corners."""
    while True:
        turn, _ = cv2.Rodrigues(rng.uniform(-0.55, 0.55, 3))
        depth_m = rng.uniform(0.35, 0.6)
        shift = np.array((rng.uniform(-0.2, 0.2), rng.uniform(-0.15, 0.15), 1.0)) * depth_m
        middle = np.array(((COLUMNS - 1) / 2, (ROWS - 1) / 2))
        axes = turn[:, :2] * SQUARE_M
        plane = np.column_stack((axes, shift - axes @ middle))
        homography = np.array([[FOCAL_PX, 0, CENTRE_PX[0]], [0, FOCAL_PX, CENTRE_PX[1]], [0, 0, 1]]) @ plane
        rim = cv2.perspectiveTransform(np.array([[[-2.0, -2], [10, -2], [10, 7], [-2, 7]]]), homography)[0]
        if (rim > 3).all() and (rim < (636, 476)).all():
            return homography, cv2.perspectiveTransform(INNER[None].astype(float), homography)[0]


def picture(homography: np.ndarray, blur_px: float, rng: np.random.Generator) -> np.ndarray:
    cell = 24
    board = np.full(((ROWS + 3) * cell, (COLUMNS + 3) * cell), 0.85, np.float32)
    for row, column in np.ndindex(ROWS + 1, COLUMNS + 1):
        if (row + column) % 2 == 0:
            board[(row + 1) * cell : (row + 2) * cell, (column + 1) * cell : (column + 2) * cell] = 0.03
    to_squares = np.array([[1 / cell, 0, -2 + 0.5 / cell], [0, 1 / cell, -2 + 0.5 / cell], [0, 0, 1]])
    enlarge = np.array([[LARGE, 0, (LARGE - 1) / 2], [0, LARGE, (LARGE - 1) / 2], [0, 0, 1]])
    size = (640 * LARGE, 480 * LARGE)
    light = cv2.warpPerspective(board, enlarge @ homography @ to_squares, size, borderValue=0.35)
    light = cv2.GaussianBlur(cv2.resize(light, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), blur_px)
    values = 255 * light ** (1 / 2.2) + rng.normal(0, 2, light.shape)
    return np.repeat(np.clip(values, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


def views(blur_px: float, count: int) -> tuple[list[BoardView], list[float]]:
    """Return the boards that are found, and the root mean square error of the corners of each."""
    found, errors_px = [], []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        homography, corners_px = place(rng)
        view = BOARD.find(f"{seed}.png", picture(homography, blur_px, rng))
        if not isinstance(view, BoardView):
            continue
        found.append(view)
        both_ways = (corners_px, corners_px[::-1])
        errors_px.append(min(float(np.sqrt(np.mean((view.corners_px - each) ** 2))) for each in both_ways))
    assert len(found) >= count - 1, "OpenCV 4.10 does not see the most tilted of the blurred boards"
    return found, errors_px


@pytest.mark.parametrize(("blur_px", "limit_px", "focal_share"), [(0.7, 0.06, 0.001), (2.5, 0.12, 0.005)])
def test_corners_are_found_in_sharp_and_in_blurred_pictures(
    blur_px: float, limit_px: float, focal_share: float
) -> None:
    found, errors_px = views(blur_px, 8)
    assert float(np.median(errors_px)) < limit_px
    assert sorted(errors_px)[-2] < 3 * limit_px, "one that has lost a corner is left out by the fit"
    made = calibrate_board(found, 640, 480, date="2026-01-31")
    assert made.rms_px < 2 * limit_px
    assert made.camera_model.fx_px == pytest.approx(FOCAL_PX, rel=focal_share)


def test_scatter_is_the_noise_of_corners_and_not_the_perspective() -> None:
    rng = np.random.default_rng(4)
    _, corners_px = place(rng)
    grid = corners_px.reshape(ROWS, COLUMNS, 2)
    assert scatter_px(grid) < 0.01
    noisy = [scatter_px(grid + rng.normal(0, 0.2, grid.shape)) for _ in range(20)]
    assert float(np.mean(noisy)) == pytest.approx(0.2, rel=0.1)
