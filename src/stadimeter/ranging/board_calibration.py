"""A whole camera model, distortion included, from pictures of a board whose corners are known.

A low reprojection error says that the model explains these corners, not that its focal length is right: boards that
all face the camera are explained as well by a longer lens further away. So its standard deviation counts, which
`stadimeter.ranging.board_calibration` gives with those of the other parameters.

The fit itself is OpenCV's, after Z. Zhang, A flexible new technique for camera calibration, 2000. Where a board that is
bent explains the corners better than a flat one, `stadimeter.ranging.board_calibration` goes on from there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX, CameraModel, LensUncertainty, Provenance
from stadimeter.core.detection import Flags, Values
from stadimeter.core.frame import Optics
from stadimeter.errors import CalibrationError

# Covariance of all parameters of a lens together, as a calibration with boards determines them ------------------------
#
# The inverse of the fit's normal matrix is the covariance of its parameters, if every corner errs by itself (R.
# Hartley and A. Zisserman, "Multiple View Geometry", section 5.2). Of each board only its own pose is unknown
# besides; it is eliminated by the Schur complement, which leaves nine unknowns. OpenCV has the diagonal of this
# matrix only, and the parameters are highly correlated: k1, k2 and k3 can all change much while no corner moves.
#
# But the corners of one board err together, by its warp or the blur of its picture. What that does shows in how the
# pull of each board on the parameters scatters: the covariance that is robust against such clusters, with the
# correction that makes it exact where corners err by themselves (R. Bell and D. McCaffrey, "Bias reduction in
# standard errors for linear regression with multi-stage samples", Survey Methodology 28, 2002). The larger of both
# counts.

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


# A board that is not quite flat: its bend is found together with the lens ---------------------------
#
# Paper that is glued to cardboard bends by some tenths of a millimetre. A fit that takes it for flat makes up for
# this with the focal length, by a percent and more than it says itself. The bend is the same in all pictures, so
# three numbers more take care of it: the z of a corner is a quadratic form of its place on the board (after K.
# Strobl and G. Hirzinger, "More accurate pinhole camera calibration with imperfect planar target", ICCV workshops
# 2011, who free every corner).

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


# The calibration: which views count, and the lens that fits them ------------------------------------------------------

# Fewer views do not fix focal length, centre and distortion.
VIEWS_MIN = 3

# So many views at least; fewer may fit by chance.
VIEWS_ENOUGH = 10

# A focal length less sure than this is no calibration.
FOCAL_SIGMA_MAX = 0.2

# Two views are the same if their corners are on average no further apart than this share of the picture's width.
SAME_VIEW_SHARE = 0.005

_OUTLIER_MADS = 5.0
_OUTLIER_MEDIANS = 2.5
_COVERAGE_CELLS = (8, 6)
_CORNERS_IN_COMMON = 4


class BoardView(Struct, frozen=True, kw_only=True, eq=False):
    """The corners of a board in one picture."""

    picture: str
    board_m: Values  # where the corners are on the board, shape (n, 2)
    corners_px: Values  # where they are in the picture, shape (n, 2), in the same order


class ViewError(Struct, frozen=True, kw_only=True):
    """The fit of one picture to the camera model."""

    picture: str
    corners: int
    # Root of the mean squared distance between where they are and where the model has them; NaN for a picture
    # that was left out before the fit.
    rms_px: float
    why_left_out: str = ""  # why it was left out; empty if it was not

    @property
    def was_left_out(self) -> bool:
        """True if the picture was left out."""
        return bool(self.why_left_out)


class BoardCalibration(Struct, frozen=True, kw_only=True):
    """A camera model and how far to trust it."""

    camera_model: CameraModel
    views: tuple[ViewError, ...]  # one for each picture, in their order
    rms_px: float  # the reprojection error over all pictures that were used
    coverage: float  # the share of the picture's area, in cells of a grid, that has a corner in some picture
    uncovered: tuple[str, ...]  # the ninths of the picture without any corner, in words such as ``upper left``
    bend_m: float = 0.0  # from the lowest corner of the board to the highest; 0 for one that may be flat


class _LensFit(Struct, frozen=True, kw_only=True, eq=False):
    lens: Values  # in the order of `stadimeter.core.camera_model.PARAMETERS`
    boards: tuple[PlacedBoard, ...]  # one for each view

    @property
    def view_rms_px(self) -> Values:
        """The reprojection error of each view."""
        return np.array([math.sqrt(np.mean(np.square(distances_px(each, self.lens)))) for each in self.boards])

    @property
    def rms_px(self) -> float:
        """The reprojection error."""
        every_px = np.concatenate([distances_px(each, self.lens) for each in self.boards])
        return math.sqrt(np.mean(np.square(every_px)))

    @property
    def bend_m(self) -> float:
        """From the lowest corner of the board to the highest."""
        return float(np.ptp(np.concatenate([each.board_m[:, 2] for each in self.boards])))


def calibrate_board(
    views: Sequence[BoardView], width_px: int, height_px: int, *, date: str, optics: Optics | None = None
) -> BoardCalibration:
    """Make a camera model from three views of a board or more, of one resolution, with the figures to judge it by.

    Views that are the same as another are left out: they say nothing new, and would make the fit look surer than it is.
    So are those that fit far worse than the others, the worst first: one bad view spoils the fit of the good ones.

    Args:
        optics: How the camera was set in all of them, if that is known.

    Raises:
        CalibrationError: There are too few views, or they do not fix the focal length.
    """
    shape = (width_px, height_px)
    used, same = _drop_repeated(views, width_px * SAME_VIEW_SHARE)
    if len(used) < VIEWS_MIN:
        raise CalibrationError(
            f"the board was found in {len(used)} different views; a calibration needs {VIEWS_MIN} at least, and is "
            "better with 10 to 20, the board tilted to all sides and in all corners of the picture"
        )
    fit, used, bad = _drop_outliers(used, shape)
    errors = dict(zip(map(id, used), fit.view_rms_px, strict=True))
    share, uncovered = coverage(used, width_px, height_px)
    return BoardCalibration(
        camera_model=replace(_model(fit, used, shape, date), optics=optics),
        views=tuple(
            same.get(id(view))
            or bad.get(id(view))
            or ViewError(picture=view.picture, corners=len(view.corners_px), rms_px=float(errors[id(view)]))
            for view in views
        ),
        rms_px=fit.rms_px,
        coverage=share,
        uncovered=uncovered,
        bend_m=fit.bend_m,
    )


def _drop_repeated(views: Sequence[BoardView], same_px: float) -> tuple[list[BoardView], dict[int, ViewError]]:
    different: list[BoardView] = []
    same: dict[int, ViewError] = {}
    for view in views:
        other = next((each for each in different if apart_px(view, each) < same_px), None)
        if other is None:
            different.append(view)
        else:
            why = f"the same view as {other.picture}"
            same[id(view)] = ViewError(
                picture=view.picture, corners=len(view.corners_px), rms_px=math.nan, why_left_out=why
            )
    return different, same


def apart_px(view: BoardView, other: BoardView) -> float:
    """Return the mean distance between the corners that two views share; infinite if there are fewer than four."""
    # Mean distance in pixels between the same corners; four corners fix a plane's picture, fewer say nothing.
    here, there = in_common(view, other)
    if len(here) < _CORNERS_IN_COMMON:
        return math.inf
    return float(np.linalg.norm(here - there, axis=1).mean())


def in_common(view: BoardView, other: BoardView) -> tuple[Values, Values]:
    """Return the corners of the one and the other view that both of them show, ``(n, 2)`` each, in the same order."""
    if np.array_equal(view.board_m, other.board_m):
        return view.corners_px, other.corners_px
    places = {tuple(corner): index for index, corner in enumerate(other.board_m)}
    pairs = [(index, places.get(tuple(corner))) for index, corner in enumerate(view.board_m)]
    both = np.array([pair for pair in pairs if pair[1] is not None], dtype=np.intp).reshape(-1, 2)
    return view.corners_px[both[:, 0]], other.corners_px[both[:, 1]]


def coverage(views: Sequence[BoardView], width_px: int, height_px: int) -> tuple[float, tuple[str, ...]]:
    """Return the share of the picture's area with a corner, in cells of a grid, and its ninths without any in words."""
    shape = (width_px, height_px)
    rows, columns = np.nonzero(~_mark_covered(views, shape, (3, 3)))
    uncovered = tuple(_PLACES[row][column] for row, column in zip(rows, columns, strict=True))
    return float(_mark_covered(views, shape, _COVERAGE_CELLS).mean()), uncovered


def _drop_outliers(
    views: list[BoardView], shape: tuple[int, int]
) -> tuple[_LensFit, list[BoardView], dict[int, ViewError]]:
    used, bad = list(views), {}
    # Greedy removal of the worst view and a new fit, since one bad view moves the reprojection error of all.
    fit = _fit(used, shape)
    while len(used) > VIEWS_MIN and (limit_px := outlier_limit_px(fit.view_rms_px)) < fit.view_rms_px.max():
        worst = int(fit.view_rms_px.argmax())
        view = used.pop(worst)
        bad[id(view)] = ViewError(
            picture=view.picture,
            corners=len(view.corners_px),
            rms_px=float(fit.view_rms_px[worst]),
            why_left_out=f"it fits far worse than the others, which allow {limit_px:.2f} px",
        )
        fit = _fit(used, shape)
    return fit, used, bad


def outlier_limit_px(view_rms_px: Values) -> float:
    """Return the worst fit a view may have: far from the median, both in standard deviations and in proportion."""
    median = float(np.median(view_rms_px))
    sigma = 1.4826 * float(np.median(np.abs(view_rms_px - median)))
    return max(median + _OUTLIER_MADS * sigma, _OUTLIER_MEDIANS * median)


def _fit(views: Sequence[BoardView], shape: tuple[int, int]) -> _LensFit:
    """Fit all five coefficients, or all but k3 where with it the lens would fold the picture; and the board's bend."""
    fit = _opencv_fit(views, shape, 0)
    if not _is_lens(fit, shape):
        fit = _opencv_fit(views, shape, cv2.CALIB_FIX_K3)
    ways = ways_to_bend([each.board_m for each in views])
    found = fit_bent([replace(board, bends=way) for board, way in zip(fit.boards, ways, strict=True)], fit.lens)
    if found is None:
        return fit
    bent = _LensFit(lens=found[1], boards=tuple(found[0]))
    return bent if _is_lens(bent, shape) else fit


def _is_lens(fit: _LensFit, shape: tuple[int, int]) -> bool:
    """Check whether the lens can be one: it does not fold the picture."""
    try:
        _lens(fit, shape)
    except CalibrationError:
        return False
    return True


def _opencv_fit(views: Sequence[BoardView], shape: tuple[int, int], flags: int) -> _LensFit:
    board, corners = _to_opencv(views)
    matrix: NDArray[Any] = np.eye(3)
    distortion: NDArray[Any] = np.zeros((1, 5))
    try:
        _, new_matrix, new_distortion, turns, shifts = cv2.calibrateCamera(
            board, corners, shape, matrix, distortion, flags=flags
        )
    except cv2.error as error:
        raise CalibrationError(
            "the pictures do not fix the camera: the corners allow no fit; tilt the board to all sides, by 30 to 45 "
            "degrees"
        ) from error
    matrix, distortion = np.asarray(new_matrix, np.float64), np.asarray(new_distortion, np.float64)
    return _LensFit(
        lens=np.concatenate((matrix[(0, 1, 0, 1), (0, 1, 2, 2)], distortion.ravel()[:5])),
        boards=tuple(
            PlacedBoard(
                board_m=np.column_stack((view.board_m, np.zeros(len(view.board_m)))),
                bends=np.empty((len(view.board_m), 0)),
                corners_px=view.corners_px,
                turn=np.asarray(turn, np.float64),
                shift=np.asarray(shift, np.float64),
            )
            for view, turn, shift in zip(views, turns, shifts, strict=True)
        ),
    )


def _to_opencv(views: Sequence[BoardView]) -> tuple[list[NDArray[Any]], list[NDArray[Any]]]:
    """Return the corners as OpenCV wants them: the board as a plane at z = 0, single precision."""
    board = [np.column_stack((each.board_m, np.zeros(len(each.board_m)))) for each in views]
    return (
        [each.astype(np.float32).reshape(-1, 1, 3) for each in board],
        [each.corners_px.astype(np.float32).reshape(-1, 1, 2) for each in views],
    )


def _lens(fit: _LensFit, shape: tuple[int, int]) -> CameraModel:
    fx_px, fy_px, cx_px, cy_px, *distortion = map(float, fit.lens)
    return CameraModel(
        width_px=shape[0],
        height_px=shape[1],
        fx_px=fx_px,
        fy_px=fy_px,
        cx_px=cx_px,
        cy_px=cy_px,
        distortion=tuple(distortion),
    )


def _model(fit: _LensFit, views: Sequence[BoardView], shape: tuple[int, int], date: str) -> CameraModel:
    covariance = lens_covariance(fit.boards, fit.lens)
    fx_px, fy_px = map(float, fit.lens[:2])
    # The worse of both axes, as a share. σ, not the reprojection error, is what tells a good calibration: frontal
    # boards are explained as well by a longer lens further away, of which the centre may be anywhere.
    share = math.sqrt(max(covariance[0, 0] / fx_px**2, covariance[1, 1] / fy_px**2))
    if not (math.isfinite(share) and share < FOCAL_SIGMA_MAX):
        raise CalibrationError(
            f"the pictures do not tell the focal length: {fx_px:.0f} px ± {share:.0%}; tilt the board by 30 to 45 "
            "degrees in several of them, to different sides"
        )
    lens = _lens(fit, shape)
    notes = (
        f"reprojection error {fit.rms_px:.3f} px over {len(views)} pictures",
        *([f"the board is bent by {fit.bend_m * 1e3:.2f} mm, which was allowed for"] if fit.bend_m else []),
        *(f"{view.picture}: {rms_px:.3f} px" for view, rms_px in zip(views, fit.view_rms_px, strict=True)),
    )
    method = f"{len(views)} pictures of a board"
    return replace(
        lens,
        edge_bias_sigma_px=UNKNOWN_EDGE_BIAS_SIGMA_PX,
        focal_relative_sigma=share,
        uncertainty=LensUncertainty.of(covariance),
        provenance=Provenance(method=method, date=date, notes=notes),
    )


def _mark_covered(views: Sequence[BoardView], shape: tuple[int, int], cells: tuple[int, int]) -> Flags:
    """Return which cells of a grid over the picture have a corner, shape (rows, columns)."""
    covered = np.zeros(cells[::-1], dtype=np.bool_)
    corners = np.concatenate([view.corners_px for view in views])
    # Pixel centres are whole numbers, so the picture begins at -0.5: half a pixel is added before cells are counted.
    columns, rows = np.floor((corners + 0.5) / np.array(shape) * np.array(cells)).astype(int).T
    covered[rows.clip(0, cells[1] - 1), columns.clip(0, cells[0] - 1)] = True
    return covered


_PLACES = (
    ("upper left", "upper middle", "upper right"),
    ("left", "middle", "right"),
    ("lower left", "lower middle", "lower right"),
)
