"""How well a calibration with boards determines all parameters of a lens together.

The inverse of the fit's normal matrix is the covariance of its parameters, if every corner errs by itself (R. Hartley
and A. Zisserman, "Multiple View Geometry", section 5.2). Of each board only its own pose is unknown besides; it is
eliminated by the Schur complement, which leaves nine unknowns. OpenCV has the diagonal of this matrix only, and the
parameters are highly correlated: k1, k2 and k3 can all change much while no corner moves.

The corners of one board err together, by its warp or the blur of its picture. So the covariance is enlarged by what the
parameters change more than it allows for when groups of boards are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

_OF_POSE = 6
_LEAST_EIGENVALUE = 1e-13
"""As a share of the largest: smaller ones are rounding errors."""


def lens_covariance(
    boards_m: Sequence[Matrix], seen_px: Sequence[Matrix], poses: Sequence[tuple[Matrix, Matrix]], lens: Matrix
) -> Matrix:
    """Return the covariance of fx, fy, cx, cy, k1, k2, p1, p2 and k3; zero for k3 if that is zero.

    Args:
        boards_m: The corners on each board, shape (n, 3).
        seen_px: Where they were seen, shape (n, 2).
        poses: Rotation vector and position of each board.
        lens: The nine parameters.
    """
    fitted = slice(0, 9 if lens[8] else 8)
    normal = np.zeros((9, 9))
    squares, freedom = 0.0, -float(len(lens[fitted]))
    for board_m, corners_px, (turn, shift) in zip(boards_m, seen_px, poses, strict=True):
        there_px, jacobian = cv2.projectPoints(board_m, turn, shift, _matrix(lens), lens[4:])
        of_pose, of_lens = jacobian[:, :_OF_POSE], jacobian[:, _OF_POSE : _OF_POSE + 9]
        shared = of_pose.T @ of_lens
        normal += of_lens.T @ of_lens - shared.T @ np.linalg.pinv(of_pose.T @ of_pose) @ shared
        squares += float(np.sum((there_px.reshape(-1, 2) - corners_px) ** 2))
        freedom += corners_px.size - _OF_POSE
    covariance = np.zeros((9, 9))
    # In units in which the diagonal is 1: coefficients of high powers differ by orders of magnitude.
    scale = 1 / np.sqrt(np.diag(normal)[fitted].clip(1e-300))
    scaled = normal[fitted, fitted] * np.outer(scale, scale)
    covariance[fitted, fitted] = np.linalg.pinv(scaled, _LEAST_EIGENVALUE, hermitian=True) * np.outer(scale, scale)
    return covariance * squares / max(freedom, 1.0)


def jackknife_covariance(left_out: Matrix) -> Matrix:
    """Return the covariance of parameters from what they were without each group of views, shape (groups, 9)."""
    groups = len(left_out)
    spread = left_out - left_out.mean(axis=0)
    return np.asarray((groups - 1) / groups * spread.T @ spread)


def enlargement(covariance: Matrix, observed: Matrix) -> float:
    """Return by which factor variances are larger than a covariance says, on average over all directions; 1 at least.

    The average over all directions is far surer than any single one: few groups of views say little about each.
    """
    known = np.ix_(*[np.flatnonzero(np.diag(covariance) > 0)] * 2)
    sigmas = np.sqrt(np.diag(covariance[known]))
    scale = np.outer(sigmas, sigmas)
    ratio = np.linalg.pinv(covariance[known] / scale, _LEAST_EIGENVALUE, hermitian=True) @ (observed[known] / scale)
    mean = float(np.trace(ratio)) / len(sigmas)
    return max(1.0, mean) if math.isfinite(mean) else 1.0


def _matrix(lens: Matrix) -> Matrix:
    return np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])
