"""The corners of a chessboard to a few hundredths of a pixel, in sharp pictures and in blurred ones.

OpenCV's ``cornerSubPix`` looks at a window around each corner. The larger it is the less noise and blur matter, until
it reaches the neighbours, which a tilted board or a bent picture brings nearer. Which window is best differs from
picture to picture, so several are tried. ``findChessboardCornersSB`` (A. Duda and U. Frese, "Accurate detection and
localization of checkerboard corners for calibration", BMVC 2018) is surer where little is left of the corners, but
shifts them by up to a third of a pixel where the board is seen obliquely, alike for neighbours.

How good corners are shows without a lens: along a row or column of a board their places are a smooth curve, and the
third difference of it is noise, multiplied by the square root of 20.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[Any]
Corners = NDArray[np.float64]

WINDOW_SHARES = (0.3, 0.4, 0.45)
"""Half the window around a corner, as shares of the distance to the nearest other corner."""

WINDOW_MIN_PX, WINDOW_MAX_PX = 2, 30

ROUGH_PX = 0.15
"""Corners that scatter by more than this are compared with those of ``findChessboardCornersSB``."""

SECTOR_DOUBT = 3.0
"""Their errors are alike for neighbours, so larger than they scatter by this factor: measured on rendered boards."""

_REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)


def refined(grey: Grey, rough: Grey, columns: int, rows: int) -> Corners:
    """Return the corners that scatter least, shape (rows * columns, 2), from roughly placed ones in order of rows."""
    grid = rough.reshape(rows, columns, 2)
    spacing_px = _smallest_spacing_px(grid)
    tried = [_in_window(grey, grid, share * spacing_px) for share in WINDOW_SHARES]
    scatters_px = [scatter_px(each) for each in tried]
    best = int(np.argmin(scatters_px))
    if scatters_px[best] > ROUGH_PX:
        found, sectors = cv2.findChessboardCornersSB(grey, (columns, rows))
        if found and SECTOR_DOUBT * scatter_px(sectors.reshape(rows, columns, 2)) < scatters_px[best]:
            return np.asarray(sectors, np.float64).reshape(-1, 2)
    return tried[best].reshape(-1, 2)


def scatter_px(grid: NDArray[Any]) -> float:
    """Return by how much corners scatter about smooth curves, along each axis; 0 for a grid of less than four.

    Args:
        grid: Corners in the picture, shape (rows, columns, 2).
    """
    differences = [np.diff(grid, 3, axis=axis).ravel() for axis in (0, 1) if grid.shape[axis] > 3]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2) / 20)) if differences else 0.0


def _in_window(grey: Grey, grid: NDArray[Any], half_px: float) -> Corners:
    window = int(np.clip(half_px, WINDOW_MIN_PX, WINDOW_MAX_PX))
    start = grid.reshape(-1, 1, 2).astype(np.float32)
    found = cv2.cornerSubPix(grey, start, (window, window), (-1, -1), _REFINED)
    return np.asarray(found, np.float64).reshape(grid.shape)


def _smallest_spacing_px(grid: NDArray[Any]) -> float:
    """Return the least distance between neighbours."""
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2) for axis in (0, 1)]
    return float(min(step.min() for step in steps))
