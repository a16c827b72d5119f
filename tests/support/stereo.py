"""Two cameras beside each other: as they are, as boards before them tell, and what both see of one target.

A pair of pictures is one scene twice, with the target moved into the other camera's frame. What is behind the target is
other clutter in the other picture: its parallax is taken to be so large that nothing of it is the same.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points, Values
from stadimeter.core.stereo_rig import UNKNOWNS, StereoRig, with_uncertainties
from stadimeter.ranging.board_calibration import BoardView, calibrate_board
from stadimeter.ranging.stereo_calibration import PairView, StereoCalibration, calibrate_stereo
from support.scenes.ball import BallTarget
from support.scenes.draw import CAMERA
from support.scenes.plane import Pose
from support.scenes.scene import Scene

BOARD_M = np.column_stack([axis.ravel() for axis in np.meshgrid(np.arange(9), np.arange(6))]) * 0.025
BASELINE_M = 0.12
PAIRS = 13
CORNER_NOISE_PX = 0.1
SQUARE_SHARE = 0.002
OTHER_PICTURE = 500_000
"""The seed of the right picture is as much higher."""


def rotation_of(turn_rad: Points) -> Values:
    """Return the matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(turn_rad))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = np.asarray(turn_rad) / angle
    across = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.eye(3) + math.sin(angle) * across + (1 - math.cos(angle)) * across @ across


def true_rig(seed: int) -> StereoRig:
    """Return two cameras of 600 px that are not quite parallel, and known exactly."""
    rng = np.random.default_rng((seed, 60))
    right = CameraModel.with_focal_length(600.0 * float(rng.normal(1, 0.005)), CAMERA.width_px, CAMERA.height_px)
    right = replace(right, cx_px=right.cx_px + float(rng.normal(0, 4)), cy_px=right.cy_px + float(rng.normal(0, 4)))
    turn, off_m = rng.normal(0, math.radians(1.0), 3), rng.normal(0, 0.002, 3)
    return StereoRig(
        left=CAMERA,
        right=right,
        turn_rad=tuple(turn.tolist()),
        place_m=tuple(np.add(off_m, (BASELINE_M, 0.0, 0.0)).tolist()),
        covariance=np.zeros((UNKNOWNS, UNKNOWNS)),
    )


def in_right(points_m: Points, rig: StereoRig) -> Points:
    """Return points of the left camera's frame in the right one's."""
    return np.asarray((points_m - rig.place_m) @ rotation_of(np.array(rig.turn_rad)))


def project(points_m: Points, camera: CameraModel) -> Points:
    """Return where points appear."""
    return camera.project(points_m[:, :2] / points_m[:, 2:])


def drawn_pairs(rig: StereoRig, seed: int, *, board_m: Points = BOARD_M) -> list[PairView]:
    """Draw boards, bent by their z, that both cameras see whole, tilted to all sides, with noise on every corner."""
    rng = np.random.default_rng((seed, 61))
    rise = board_m[:, 2:] if board_m.shape[1] == 3 else np.zeros((len(board_m), 1))
    flat = np.hstack((board_m[:, :2] - board_m[:, :2].mean(axis=0), rise))
    made: list[PairView] = []
    while len(made) < PAIRS:
        depth_m = float(rng.uniform(0.35, 0.8))
        x, y = rig.left.direction(*rng.uniform((60, 60), (580, 420)))
        turned = flat @ rotation_of(rng.uniform(-0.6, 0.6, 3)).T
        points_m = turned + np.array((x * depth_m + rig.place_m[0] / 2, y * depth_m, depth_m))
        seen = [project(points_m, rig.left), project(in_right(points_m, rig), rig.right)]
        if all((each > 3).all() and (each < (636, 476)).all() for each in seen):
            left, right = (
                BoardView(
                    picture=f"{side}{len(made):02}.png",
                    board_m=BOARD_M,
                    corners_px=corners_px + rng.normal(0, CORNER_NOISE_PX, corners_px.shape),
                )
                for side, corners_px in zip(("left", "right"), seen, strict=True)
            )
            made.append(PairView(left=left, right=right))
    return made


def calibrate_pairs(pairs: list[PairView], square_share: float = 0.0) -> StereoCalibration:
    """Calibrate as the command does."""
    alone = [calibrate_board([getattr(each, side) for each in pairs], 640, 480, date="") for side in ("left", "right")]
    return calibrate_stereo(pairs, (alone[0], alone[1]), date="2026-01-31", square_share=square_share)


def calibrated_rig(rig: StereoRig, seed: int) -> StereoRig:
    """Return what boards before two cameras tell of them; the squares are not quite as large as stated."""
    larger = float(np.random.default_rng((seed, 62)).normal(1, SQUARE_SHARE))
    return calibrate_pairs(drawn_pairs(rig, seed, board_m=BOARD_M * larger), SQUARE_SHARE).rig


class ScenePair(Struct, frozen=True, kw_only=True):
    """What both cameras look at."""

    left: Scene
    right: Scene


def pair_of(scene: Scene, rig: StereoRig) -> ScenePair:
    """Return a scene as both cameras of a rig see it."""
    target: Any = scene.target
    rotation = rotation_of(np.array(rig.turn_rad))
    place = in_right(np.array([target.position_m]), rig)[0]
    position_m = tuple(place.tolist())
    if isinstance(target, BallTarget):
        moved = replace(target, position_m=position_m, light=tuple((np.array(target.light) @ rotation).tolist()))
    else:
        moved = replace(target, pose=_pose(rotation.T @ target.pose.rotation(), position_m))
    right = replace(scene, camera=rig.right, target=moved, seed=scene.seed + OTHER_PICTURE)
    return ScenePair(left=replace(scene, camera=rig.left), right=right)


def _pose(axes: Values, position_m: tuple[float, ...]) -> Pose:
    """Return the pose with these axes: the columns of the matrix."""
    x, y, z = axes[:, 2]
    tilted = Pose(position_m=position_m, tilt_rad=math.acos(min(1.0, z)), tilt_towards_rad=math.atan2(y, x))
    rolled = tilted.rotation().T @ axes
    return replace(tilted, roll_rad=math.atan2(rolled[1, 0], rolled[0, 0]))


def known_exactly(rig: StereoRig) -> StereoRig:
    """Return a rig of which nothing is uncertain."""
    return with_uncertainties(replace(rig, covariance=np.zeros((UNKNOWNS, UNKNOWNS))))
