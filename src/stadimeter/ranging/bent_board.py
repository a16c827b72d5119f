"""A board that is not quite flat: its bend is found together with the lens.

Paper that is glued to cardboard bends by some tenths of a millimetre. A fit that takes it for flat makes up for this
with the focal length, by a percent and more than it says itself. The bend is the same in all pictures, so three numbers
more take care of it: the z of a corner is a quadratic form of its place on the board (after K. Strobl and G. Hirzinger,
"More accurate pinhole camera calibration with imperfect planar target", ICCV workshops 2011, who free every corner).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from msgspec.structs import replace

from stadimeter.core.detection import Values
from stadimeter.ranging.fit_covariance import PlacedBoard, camera_matrix, inverse_root, without_poses

# Steps of Gauss and Newton, from the fit of a flat board; they end when the lens moves by less than this share.
_STEPS_MAX, _SETTLED = 20, 1e-6

# How much more the three numbers must explain than noise lets them: the F statistic, of which 5.4 is the quantile of
# 0.999. From 0.2 mm on, 15 pictures of a board of 20 cm show a bend.
_F_MIN = 5.5


def ways_to_bend(boards: Sequence[Values]) -> list[Values]:
    """Return the rise of each corner, for bends along the board, across it and of its corners, shape ``(n, 3)``.

    The board is one; pictures may show a part of it. A bend of 1 raises the ends of its longer side by 1.

    Args:
        boards: The corners in each picture on the board, shape ``(n, 2)``.
    """
    every = np.concatenate(boards)
    low, high = every.min(axis=0), every.max(axis=0)
    half_m = max(float((high - low).max()) / 2, 1e-9)
    places = [(each - (low + high) / 2) / half_m for each in boards]
    return [np.column_stack((u * u, v * v, u * v)) for u, v in (each.T for each in places)]


def fit_bent(boards: Sequence[PlacedBoard], lens: Values) -> tuple[list[PlacedBoard], Values] | None:
    """Return boards that are bent alike, and the lens, fitted together; None if the board may as well be flat.

    Args:
        boards: As the fit of a flat board has them, with the ways to bend.
        lens: Of that fit, in the order of `stadimeter.core.camera_model.PARAMETERS`.
    """
    bent, squares = list(boards), _squares(boards, lens)
    flat_squares = squares
    # Two coordinates a corner, less six unknowns a board, nine of the lens and three of the bend.
    free = sum(2 * len(each.board_m) - 6 for each in boards) - 12
    for _ in range(_STEPS_MAX):
        # A step of lens and bend together, which poses make up for as far as they can; then the poses themselves.
        jacobians, residuals_px = without_poses(bent, lens)
        pairs = list(zip(jacobians, residuals_px, strict=True))
        root = inverse_root(np.sum([each.T @ each for each in jacobians], axis=0))
        step = root @ (root.T @ np.sum([each.T @ off_px for each, off_px in pairs], axis=0))
        moved = lens.copy()
        moved[: len(step) - 3] += step[:-3]
        raised = [_refine_pose(_rise(each, step[-3:]), moved) for each in bent]
        before, after = squares, _squares(raised, moved)
        if not after < before:
            break
        bent, lens, squares = raised, moved, after
        if np.abs(step[:2] / lens[:2]).max() < _SETTLED:
            break
    is_bent = free > 0 and (flat_squares - squares) / 3 > _F_MIN * squares / free
    return (bent, lens) if is_bent else None


def _rise(board: PlacedBoard, bends: Values) -> PlacedBoard:
    return replace(board, board_m=board.board_m + np.outer(board.bends @ bends, (0.0, 0.0, 1.0)))


def _refine_pose(board: PlacedBoard, lens: Values) -> PlacedBoard:
    start = board.turn.copy(), board.shift.copy()  # OpenCV writes into them
    turn, shift = cv2.solvePnPRefineLM(board.board_m, board.corners_px, camera_matrix(lens), lens[4:], *start)
    return replace(board, turn=np.asarray(turn, np.float64), shift=np.asarray(shift, np.float64))


def _squares(boards: Sequence[PlacedBoard], lens: Values) -> float:
    """Return the sum of the squared distances of corners from where they should be."""
    return float(sum(np.sum(np.square(distances_px(each, lens))) for each in boards))


def distances_px(board: PlacedBoard, lens: Values) -> Values:
    """Measure how far each corner was seen from where it should be, shape ``(n,)``."""
    there_px, _ = cv2.projectPoints(board.board_m, board.turn, board.shift, camera_matrix(lens), lens[4:])
    return np.asarray(np.linalg.norm(board.corners_px - np.asarray(there_px).reshape(-1, 2), axis=1))
