"""Covariance of all parameters of a lens together, as a calibration with boards determines them.

The inverse of the fit's normal matrix is the covariance of its parameters, if every corner errs by itself (R. Hartley
and A. Zisserman, "Multiple View Geometry", section 5.2). Of each board only its own pose is unknown besides; it is
eliminated by the Schur complement, which leaves nine unknowns. OpenCV has the diagonal of this matrix only, and the
parameters are highly correlated: k1, k2 and k3 can all change much while no corner moves.

But the corners of one board err together, by its warp or the blur of its picture. What that does shows in how the pull
of each board on the parameters scatters: the covariance that is robust against such clusters, with the correction that
makes it exact where corners err by themselves (R. Bell and D. McCaffrey, "Bias reduction in standard errors for linear
regression with multi-stage samples", Survey Methodology 28, 2002). The larger of both counts.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Values

# As a share of the largest: smaller ones are rounding errors.
_OF_POSE = 6
_MIN_EIGENVALUE = 1e-13

_MAX_LEVERAGE = 0.9999


class PlacedBoard(Struct, frozen=True, kw_only=True, eq=False):
    """A board as a fit has it."""

    board_m: Values  # its corners, shape (n, 3)
    bends: Values  # how their z follows from the ways in which the board is bent, shape (n, 3); (n, 0) for a flat one
    corners_px: Values  # where they were seen, shape (n, 2)
    turn: Values  # its rotation vector, shape (3, 1)
    shift: Values  # its position, shape (3, 1)


def lens_covariance(boards: Sequence[PlacedBoard], lens: Values) -> Values:
    """Return the covariance of fx, fy, cx, cy, k1, k2, p1, p2 and k3; zero for k3 if that is zero."""
    jacobians, residuals_px = without_poses(boards, lens)
    root = inverse_root(np.sum([each.T @ each for each in jacobians], axis=0))
    variance_px2 = corner_variance_px2(jacobians, residuals_px, root, (0, 1))
    fitted = slice(0, _fitted(lens))
    covariance = np.zeros((9, 9))
    # Those of the bends are left out: what not knowing them does to the lens is in its own part of the inverse.
    covariance[fitted, fitted] = (root @ root.T * variance_px2)[fitted, fitted]
    return covariance


def corner_variance_px2(
    jacobians: Sequence[Values], residuals_px: Sequence[Values], root: Values, decisive: Sequence[int]
) -> float:
    """Return the variance of a corner's coordinates, the larger of that of the residuals and that of boards together.

    Args:
        jacobians: How the corners of each board move with the parameters, its own pose eliminated.
        root: `inverse_root` of their normal matrix.
        decisive: The parameters that every distance rests on.
    """
    # Two residuals a corner, less six unknowns a board and those of the lens.
    freedom = sum(map(len, residuals_px)) - _OF_POSE * len(residuals_px) - len(root)
    variance_px2 = float(sum(each @ each for each in residuals_px)) / max(freedom, 1)
    observed = np.sum([_pull(one @ root, two) for one, two in zip(jacobians, residuals_px, strict=True)], axis=0)
    return max(variance_px2, _largest(root, observed, decisive))


def without_poses(boards: Sequence[PlacedBoard], lens: Values) -> tuple[list[Values], list[Values]]:
    """Return motions of corners with lens and bends while each board's pose makes up for what it can, and how far off.

    The columns are the eight or nine parameters of the lens that are fitted, and then the bends.
    """
    seen = [_without_pose(board, lens) for board in boards]
    return [each for each, _ in seen], [each for _, each in seen]


def _fitted(lens: Values) -> int:
    return 9 if lens[8] else 8


def _without_pose(board: PlacedBoard, lens: Values) -> tuple[Values, Values]:
    there_px, jacobian = cv2.projectPoints(board.board_m, board.turn, board.shift, camera_matrix(lens), lens[4:])
    # Schur complement by projection: Q Q' is the projector on the columns of the pose, what is left is what no pose of
    # this board can make up for.
    of_pose, _ = np.linalg.qr(jacobian[:, :_OF_POSE])
    off_px = board.corners_px.ravel() - np.asarray(there_px, np.float64).ravel()
    # A corner that rises from the board moves like the board that is shifted along its normal.
    normal = cv2.Rodrigues(board.turn)[0][:, 2]
    rising = np.asarray(jacobian, np.float64)[:, 3:_OF_POSE] @ normal
    bent = rising[:, None] * np.repeat(board.bends, 2, axis=0)
    of_lens = np.asarray(jacobian, np.float64)[:, _OF_POSE : _OF_POSE + _fitted(lens)]
    both = np.column_stack((of_lens, bent, off_px))
    both = np.asarray(both - of_pose @ (of_pose.T @ both), np.float64)
    return both[:, :-1], both[:, -1]


def camera_matrix(lens: Values) -> Values:
    """Return the matrix of focal lengths and principal point."""
    return np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])


def inverse_root(normal: Values) -> Values:
    """Return a matrix R with ``R R^T`` the inverse of the normal matrix.

    It is found in units in which the diagonal is 1, since coefficients of high powers differ by orders of magnitude.
    """
    scale = 1 / np.sqrt(np.diag(normal).clip(1e-300))
    values, vectors = np.linalg.eigh(normal * np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors / np.sqrt(values.clip(_MIN_EIGENVALUE * values[-1])))


def _pull(jacobian: Values, residuals_px: Values) -> Values:
    """Return the square of a board's pull on parameters in which the normal matrix is 1."""
    # Bell and McCaffrey: residuals of a board are shrunk by its own leverage, (1 - H)^-1/2 undoes that. Singular values
    # of the whitened Jacobian are the roots of the eigenvalues of H.
    left, leverage, right = np.linalg.svd(jacobian, full_matrices=False)
    factor = leverage / np.sqrt(1 - np.minimum(leverage**2, _MAX_LEVERAGE))
    pull = (left.T @ residuals_px * factor) @ right
    return np.outer(pull, pull)


def _largest(root: Values, observed: Values, decisive: Sequence[int]) -> float:
    """Return the variance of a corner that explains the pulls of boards: on the mean, and on the decisive parameters.

    The mean over all parameters is far surer than a single one, of which few boards say little. But every distance
    rests on the focal length.
    """
    of_each = [float(row @ observed @ row / (row @ row)) for row in root[list(decisive)]]
    return max(float(np.trace(observed)) / len(root), *of_each)
