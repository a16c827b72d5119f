"""The place of a second camera beside the first one, from pairs of pictures of a board that both took at one time.

Each camera is calibrated by itself first. Each pair then says where the right camera is; the one that explains the
other pairs best, by the median of their errors, is where the fit begins (least median of squares, P. Rousseeuw, 1984),
so pairs that do not belong together do not lead it astray. Then both lenses, the pose and all boards are fitted
together by Gauss and Newton, the boards' poses eliminated as in `stadimeter.ranging.board_calibration`, whose
covariance it takes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel, Provenance, all_five
from stadimeter.core.detection import Flags, Values
from stadimeter.core.stereo_rig import OF_LENS, OF_POSE, UNKNOWNS, StereoRig, with_uncertainties
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import (
    VIEWS_MIN,
    BoardCalibration,
    BoardView,
    PlacedBoard,
    camera_matrix,
    corner_variance_px2,
    distances_px,
    in_common,
    inverse_root,
    outlier_limit_px,
    ways_to_bend,
)
from stadimeter.ranging.stereo import slopes_of, triangulate

# Steps of Gauss and Newton; they end when the sum of squares falls by less than this share.
_STEPS_MAX, _SETTLED = 30, 1e-9

# A board's pose between two known cameras is found in fewer steps; which pairs agree, in fewer rounds.
_SETTLE_STEPS, _ROUNDS_MAX = 5, 5

# A baseline that is shorter than this many standard deviations may be none.
_APART_SIGMAS = 5.0

# Pairs that belong together agree on the pose within a pixel or two before the fit; unrelated ones are off by tens.
_UNRELATED_SHARE = 0.02


class PairView(Struct, frozen=True, kw_only=True, eq=False):
    """A board in two pictures that were taken at one time."""

    left: BoardView
    right: BoardView
    # How its corners rise with the bends of the board, in both pictures, shape (n, 3); (n, 0) for a flat board.
    ways: tuple[Values, ...] = ()


class PairError(Struct, frozen=True, kw_only=True):
    """The fit of one pair.

    Attributes:
        rms_px: The reprojection error over both pictures, with one pose of the board for both.
        epipolar_px: Root of the mean square by which lines of sight to one corner miss each other.
        distance_m: How far the board was from the left camera.
        why_left_out: Why it was left out; empty if it was not.
    """

    left: str
    right: str
    rms_px: float = math.nan
    epipolar_px: float = math.nan
    distance_m: float = math.nan
    why_left_out: str = ""


class StereoCalibration(Struct, frozen=True, kw_only=True):
    """Two cameras and how far to trust them; the pairs in the order in which they were given."""

    rig: StereoRig
    pairs: tuple[PairError, ...]
    rms_px: float
    epipolar_px: float


class _StereoFit(Struct, frozen=True, eq=False):
    lenses: Values  # of the left and the right camera, in the order of `PARAMETERS`, shape (2, 9)
    pose: Values  # turn and shift from the left camera's frame to the right one's, as OpenCV has them, shape (6,)
    boards: Values  # turn and shift of each board in the left camera's frame, shape (n, 6)
    bend: Values  # of the board, as in `ways_to_bend`, shape (3,); empty for a flat one


class _System(Struct, frozen=True, eq=False):
    """One pair's part of the linear system: how its corners move with all that pairs share, and with its own board."""

    shared: Values
    board: Values
    off_px: Values

    def without_board(self) -> tuple[Values, Values]:
        """Return the part no pose of the board makes up for: the Schur complement by projection, as for one camera."""
        of_board, _ = np.linalg.qr(self.board)
        both = np.column_stack((self.shared, self.off_px))
        both = np.asarray(both - of_board @ (of_board.T @ both))
        return both[:, :-1], both[:, -1]


def calibrate_stereo(
    pairs: Sequence[PairView], alone: tuple[BoardCalibration, BoardCalibration], *, date: str, square_share: float = 0.0
) -> StereoCalibration:
    """Find where the right camera is, and both lenses with it, from three pairs of pictures or more.

    Args:
        alone: What the views of each camera give by themselves, in the order of the pairs.
        square_share: Standard deviation of the side of a square, as a share: the baseline, and with it every distance,
            is wrong by as much.

    Raises:
        CalibrationError: Too few pairs belong together, the cameras are swapped, or the pairs do not fix the pose.
    """
    reasons = [one.why_left_out or two.why_left_out for one, two in zip(alone[0].views, alone[1].views, strict=True)]
    seen = _with_ways([pair for pair, why in zip(pairs, reasons, strict=True) if not why], alone)
    check_pair_count(len(seen), "show the board in both pictures")
    fit, used = _fit_agreeing(seen, alone)
    check_pair_count(int(used.sum()), "belong together")
    systems = [_linearise(pair, board, fit) for pair, board in zip(seen, fit.boards, strict=True)]
    rms_px = np.array([_rms_px(each) for each in systems])
    kept = [each for each, is_used in zip(systems, used, strict=True) if is_used]
    rig = _rig(fit, kept, alone, square_share)
    judged = iter([_judge(*each, rig) for each in zip(seen, fit.boards, rms_px, strict=True)])
    errors = []
    limit_px = outlier_limit_px(rms_px[used])
    for pair, why in zip(pairs, reasons, strict=True):
        error = PairError(left=pair.left.picture, right=pair.right.picture) if why else next(judged)
        errors.append(replace(error, why_left_out=why or _why_off(error.rms_px, limit_px)))
    good = [each for each in errors if not each.why_left_out]
    notes = tuple(f"{each.left}, {each.right}: {each.rms_px:.3f} px" for each in good)
    method = f"{len(good)} pairs of pictures of a board"
    return StereoCalibration(
        rig=replace(rig, provenance=Provenance(method=method, date=date, notes=notes)),
        pairs=tuple(errors),
        rms_px=_rms_px(*kept),
        epipolar_px=math.sqrt(np.nanmean([each.epipolar_px**2 for each in good])),
    )


def _why_off(rms_px: float, limit_px: float) -> str:
    if rms_px <= limit_px:
        return ""
    return f"it is off by {rms_px:.1f} px, the others allow {limit_px:.1f} px: were both taken at the same time?"


def check_pair_count(count: int, what: str) -> None:
    """Raise a `CalibrationError` if too few pairs are as is said, such as `belong together`."""
    if count < VIEWS_MIN:
        raise CalibrationError(
            f"{count} pairs {what}; two cameras need {VIEWS_MIN} at least, and are better with 10 to 20: both pictures "
            "of a pair taken at the same time, and given in the same order"
        )


def _fit_agreeing(
    pairs: Sequence[PairView], alone: tuple[BoardCalibration, BoardCalibration]
) -> tuple[_StereoFit, Flags]:
    """Return the fit of the pairs that agree with each other, with the boards of all; and which ones agree."""
    fit, errors_px = _start(pairs, alone)
    used = errors_px <= outlier_limit_px(errors_px)
    for _ in range(_ROUNDS_MAX):
        some = [pair for pair, is_used in zip(pairs, used, strict=True) if is_used]
        found = _adjust(some, replace(fit, boards=fit.boards[used]), _movable(fit))
        boards = [_settle(pair, board, found) for pair, board in zip(pairs, fit.boards, strict=True)]
        fit = replace(found, boards=np.array(boards))
        rms_px = np.array([_rms_px(_linearise(*each, fit)) for each in zip(pairs, boards, strict=True)])
        before, used = used, rms_px <= outlier_limit_px(rms_px[used])
        if used.sum() < VIEWS_MIN or (used == before).all():
            break
    return fit, used


def _start(pairs: Sequence[PairView], alone: tuple[BoardCalibration, BoardCalibration]) -> tuple[_StereoFit, Values]:
    """Return where the fit begins, and how far off each pair is there, in pixels."""
    lenses = np.array([_parameters(each.camera_model) for each in alone])
    left = [_board_pose(each.left, lenses[0]) for each in pairs]
    right = [_board_pose(each.right, lenses[1]) for each in pairs]
    poses = [_compose(_invert(one), two) for one, two in zip(left, right, strict=True)]
    # How far off each pair is, one in a column, if the right camera is where the pair of the row has it.
    off_px = np.array(
        [
            [
                distances_px(_placed(pair.right, _compose(board, pose)), lenses[1]).mean()
                for pair, board in zip(pairs, left, strict=True)
            ]
            for pose in poses
        ]
    )
    best = int(np.median(off_px, axis=1).argmin())
    if (least_px := float(np.median(off_px[best]))) > _UNRELATED_SHARE * alone[1].camera_model.width_px:
        raise CalibrationError(
            f"the pairs do not belong together: no place of the right camera explains half of them to within "
            f"{least_px:.0f} px; were both pictures of each pair taken at the same time, and given in the same order?"
        )
    return _StereoFit(lenses, poses[best], np.array(left), np.zeros(pairs[0].ways[0].shape[1])), off_px[best]


def _with_ways(pairs: Sequence[PairView], alone: tuple[BoardCalibration, BoardCalibration]) -> list[PairView]:
    """Return the pairs with the ways in which their board may be bent: none, unless a camera has seen that it is."""
    ways = 3 if any(each.bend_m for each in alone) else 0
    every = [
        each[:, :ways] for each in ways_to_bend([side.board_m for pair in pairs for side in (pair.left, pair.right)])
    ]
    return [
        replace(pair, ways=both) for pair, both in zip(pairs, zip(every[::2], every[1::2], strict=True), strict=True)
    ]


def _adjust(pairs: Sequence[PairView], fit: _StereoFit, movable: Flags) -> _StereoFit:
    """Return the fit with the least squares; it ends where a step makes nothing better."""
    squares = math.inf
    for _ in range(_STEPS_MAX):
        systems = [_linearise(pair, board, fit) for pair, board in zip(pairs, fit.boards, strict=True)]
        now = sum(float(each.off_px @ each.off_px) for each in systems)
        if not now < squares * (1 - _SETTLED):
            break
        best, squares = fit, now
        reduced = [each.without_board() for each in systems]
        root = inverse_root(np.sum([jacobian[:, movable].T @ jacobian[:, movable] for jacobian, _ in reduced], axis=0))
        step = np.zeros(len(movable))
        step[movable] = root @ (root.T @ np.sum([one[:, movable].T @ off_px for one, off_px in reduced], axis=0))
        moves = [np.linalg.lstsq(each.board, each.off_px - each.shared @ step, rcond=None)[0] for each in systems]
        fit = _StereoFit(
            fit.lenses + step[: 2 * OF_LENS].reshape(2, -1),
            fit.pose + step[OF_POSE],
            fit.boards + np.array(moves),
            fit.bend + step[UNKNOWNS:],
        )
    return best


def _settle(pair: PairView, board: Values, fit: _StereoFit) -> Values:
    """Return the pose of a board that explains both pictures best."""
    for _ in range(_SETTLE_STEPS):
        system = _linearise(pair, board, fit)
        board = board + np.linalg.lstsq(system.board, system.off_px, rcond=None)[0]
    return board


def _movable(fit: _StereoFit) -> Flags:
    """Return which of the shared unknowns are fitted: k3 stays where it is zero, since it would fold the picture."""
    k3 = fit.lenses[:, -1] != 0
    return np.concatenate(
        (*(np.append(np.ones(OF_LENS - 1, np.bool_), each) for each in k3), np.ones(6 + len(fit.bend), np.bool_))
    )


def _linearise(pair: PairView, board: Values, fit: _StereoFit) -> _System:
    composed = cv2.composeRT(board[:3], board[3:], fit.pose[:3], fit.pose[3:])
    there = np.concatenate((composed[0].ravel(), composed[1].ravel()))
    by_board, by_pose = np.block([[*composed[2:4]], [*composed[6:8]]]), np.block([[*composed[4:6]], [*composed[8:]]])
    parts = []
    for side, (view, placed) in enumerate(((pair.left, board), (pair.right, there))):
        ways = pair.ways[side]
        points = np.column_stack((view.board_m, ways @ fit.bend))
        at_px, jacobian = cv2.projectPoints(
            points, placed[:3], placed[3:], camera_matrix(fit.lenses[side]), fit.lenses[side, 4:]
        )
        of_placed = np.asarray(jacobian)[:, :6]
        # A corner that rises from the board moves like the board that is shifted along its normal.
        rising = of_placed[:, 3:] @ cv2.Rodrigues(placed[:3])[0][:, 2]
        shared = np.zeros((len(of_placed), UNKNOWNS + len(fit.bend)))
        shared[:, OF_LENS * side : OF_LENS * (side + 1)] = np.asarray(jacobian)[:, 6 : 6 + OF_LENS]
        shared[:, UNKNOWNS:] = rising[:, None] * np.repeat(ways, 2, axis=0)
        if side == 1:
            shared[:, OF_POSE] = of_placed @ by_pose
        off_px = view.corners_px.ravel() - np.asarray(at_px).ravel()
        parts.append((shared, of_placed if side == 0 else of_placed @ by_board, off_px))
    return _System(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _rms_px(*systems: _System) -> float:
    """Return the reprojection error: root of the mean squared distance of corners."""
    every_px = np.concatenate([each.off_px for each in systems])
    return math.sqrt(2 * float(np.mean(every_px**2)))


def _rig(
    fit: _StereoFit, systems: Sequence[_System], alone: tuple[BoardCalibration, BoardCalibration], square_share: float
) -> StereoRig:
    """Return both cameras with the covariance of all that is shared."""
    movable = _movable(fit)
    reduced = [each.without_board() for each in systems]
    jacobians, off_px = [jacobian[:, movable] for jacobian, _ in reduced], [each for _, each in reduced]
    root = inverse_root(np.sum([each.T @ each for each in jacobians], axis=0))
    # Every distance rests on the focal lengths and on how the right camera is turned.
    turn = range(OF_POSE.start, OF_POSE.start + 3)
    decisive = [int(np.count_nonzero(movable[:index])) for index in (0, 1, OF_LENS, OF_LENS + 1, *turn)]
    variance_px2 = corner_variance_px2(jacobians, off_px, root, decisive)
    covariance = np.zeros((len(movable), len(movable)))
    covariance[np.ix_(movable, movable)] = root @ root.T * variance_px2
    # From the pose that OpenCV has, of the left camera seen from the right one, to that of the right one.
    to_rig = np.eye(UNKNOWNS)
    to_rig[OF_POSE, OF_POSE] = slopes_of(_invert, fit.pose)
    covariance = to_rig @ covariance[:UNKNOWNS, :UNKNOWNS] @ to_rig.T
    pose = _invert(fit.pose)
    covariance[-3:, -3:] += square_share**2 * np.outer(pose[3:], pose[3:])
    _check_places(pose[3:], covariance[-3:, -3:])
    left, right = (
        replace(each.camera_model, **_named(lens), provenance=Provenance())
        for each, lens in zip(alone, fit.lenses, strict=True)
    )
    turn_x, turn_y, turn_z, x_m, y_m, z_m = pose.tolist()
    rig = StereoRig(
        left=left, right=right, turn_rad=(turn_x, turn_y, turn_z), place_m=(x_m, y_m, z_m), covariance=covariance
    )
    return with_uncertainties(rig)


def _check_places(place_m: Values, covariance: Values) -> None:
    baseline_m = float(np.linalg.norm(place_m))
    sigma_m = math.sqrt(float(np.trace(covariance)))
    if baseline_m < _APART_SIGMAS * sigma_m:
        raise CalibrationError(
            f"the cameras are {baseline_m:.4f} m ± {sigma_m:.4f} apart, which may be nothing: are these pictures of "
            "two cameras? If so, tilt the board in several pairs, and bring it nearer and farther"
        )
    if place_m[0] < 0 and abs(place_m[0]) == np.abs(place_m).max():
        raise CalibrationError(
            f"left and right are swapped: the camera given as the right one is {-place_m[0]:.3f} m to the left of the "
            "other; give the pictures of the other one first"
        )


def _judge(pair: PairView, board: Values, rms_px: float, rig: StereoRig) -> PairError:
    here, there = in_common(pair.left, pair.right)
    pose = np.array((*rig.turn_rad, *rig.place_m))
    _, misses = triangulate(rig.left.directions(here), rig.right.directions(there), pose)
    middle_m = cv2.Rodrigues(board[:3])[0][:, :2] @ pair.left.board_m.mean(axis=0) + board[3:]
    return PairError(
        left=pair.left.picture,
        right=pair.right.picture,
        rms_px=float(rms_px),
        epipolar_px=math.sqrt(float(np.mean(misses**2))) * rig.left.fx_px if len(here) else math.nan,
        distance_m=float(np.linalg.norm(middle_m)),
    )


def _placed(view: BoardView, pose: Values) -> PlacedBoard:
    flat = np.column_stack((view.board_m, np.zeros(len(view.board_m))))
    return PlacedBoard(
        board_m=flat, bends=np.empty((len(flat), 0)), corners_px=view.corners_px, turn=pose[:3], shift=pose[3:]
    )


def _board_pose(view: BoardView, lens: Values) -> Values:
    flat = np.column_stack((view.board_m, np.zeros(len(view.board_m))))
    _, turn, shift = cv2.solvePnP(flat, view.corners_px.reshape(-1, 1, 2), camera_matrix(lens), lens[4:])
    return np.concatenate((np.asarray(turn).ravel(), np.asarray(shift).ravel()))


def _compose(one: Values, two: Values) -> Values:
    """Return the pose that is the first one, and then the second one."""
    turn, shift, *_ = cv2.composeRT(one[:3], one[3:], two[:3], two[3:])
    return np.concatenate((np.asarray(turn).ravel(), np.asarray(shift).ravel()))


def _invert(pose: Values) -> Values:
    rotation = np.asarray(cv2.Rodrigues(pose[:3])[0])
    return np.concatenate((-pose[:3], -rotation.T @ pose[3:]))


def _parameters(lens: CameraModel) -> Values:
    return np.array((lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *all_five(lens.distortion)))


def _named(lens: Values) -> dict[str, Any]:
    fx_px, fy_px, cx_px, cy_px, *distortion = lens.tolist()
    return {"fx_px": fx_px, "fy_px": fy_px, "cx_px": cx_px, "cy_px": cy_px, "distortion": tuple(distortion)}
