"""Scenes of a robot's camera above a level floor, with what stands and lies on it, and what the camera is taken for."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing
from support.scenes.backdrop import Ground, PlainBackdrop
from support.scenes.draw import CAMERA, TAG_FAMILY, TAGS
from support.scenes.hard_balls import hard_ball
from support.scenes.plane import Pose, TagTarget
from support.scenes.scene import Scene

HEIGHT_M, HEIGHT_SIGMA_M = 0.30, 0.003
TILT_RAD, TILT_SIGMA_RAD = math.radians(-12), math.radians(0.1)
MET_PX = (10.0, 40.0)
BALL_M = 0.12
GROUNDS = (Ground.WOOD, Ground.CONCRETE, Ground.MAT)
FOCAL_SHARE = 0.005

Matrix = NDArray[np.float64]


class OnFloorScene(Struct, frozen=True, kw_only=True):
    """A scene, and what is said of the camera, which is off by as much as it is said to be."""

    scene: Scene
    footing: Footing
    camera: CameraModel
    tilt_rad: float
    height_m: float
    hsv: str | None = None


def ball_on_floor(seed: int, distance_m: float) -> OnFloorScene:
    """Draw a ball of 12 cm on a floor, so far along it."""
    rng = np.random.default_rng((seed, 90))
    rng.standard_normal()  # so that the scenes of seeds stay as they were
    height_m, level = _camera(rng)
    place = _place(rng, distance_m, height_m - BALL_M / 2)
    # A ball as it is met on a floor, with its dirt, seams and felt, through a camera of random quality.
    met = hard_ball(seed, MET_PX, backdrop=str(GROUNDS[seed % len(GROUNDS)]))
    target = replace(met.scene.target, position_m=tuple((level @ place).tolist()), diameter_m=BALL_M)
    said = _said(rng, replace(met.scene, target=target, occluder=None), height_m, level)
    return replace(said, hsv=met.hsv)


def tag_lying(seed: int, distance_m: float, side_m: float = 0.10) -> OnFloorScene:
    """Draw a tag that lies on the floor before the camera."""
    rng = np.random.default_rng((seed, 92))
    height_m, level = _camera(rng)
    flat = _about_up(float(rng.uniform(-0.6, 0.6))) @ _about_right(math.pi / 2)
    pose = _pose(level @ _place(rng, distance_m, height_m), level @ flat)
    target = TagTarget(pose=pose, side_m=side_m, family=TAG_FAMILY, number=seed % TAGS)
    return _said(rng, Scene(camera=CAMERA, target=target, seed=seed, backdrop=PlainBackdrop()), height_m, level)


def _camera(rng: np.random.Generator) -> tuple[float, Matrix]:
    """Return the camera's true height, and the turn from level axes (right, down, ahead) into its own."""
    height, tilt, roll = rng.standard_normal(3)
    angle = TILT_RAD + TILT_SIGMA_RAD * float(tilt)
    return HEIGHT_M + HEIGHT_SIGMA_M * float(height), _rolled(TILT_SIGMA_RAD * float(roll)) @ _about_right(angle)


def _place(rng: np.random.Generator, distance_m: float, below_m: float) -> NDArray[np.float64]:
    """Return a place so far away along the floor, and so far below the camera, in level axes."""
    aside = math.radians(float(rng.uniform(-10, 10)))
    return np.array((distance_m * math.sin(aside), below_m, distance_m * math.cos(aside)))


def _said(rng: np.random.Generator, scene: Scene, height_m: float, level: Matrix) -> OnFloorScene:
    share = FOCAL_SHARE * float(rng.standard_normal())
    camera = replace(
        CAMERA, fx_px=CAMERA.fx_px * (1 + share), fy_px=CAMERA.fy_px * (1 + share), focal_relative_sigma=FOCAL_SHARE
    )
    footing = Footing(
        height_m=HEIGHT_M, height_sigma_m=HEIGHT_SIGMA_M, tilt_rad=TILT_RAD, tilt_sigma_rad=TILT_SIGMA_RAD
    )
    tilt_rad = -math.asin(float(level[2, 1]))  # of the vertical, level (0, 1, 0), the part along the optical axis
    return OnFloorScene(scene=scene, footing=footing, camera=camera, tilt_rad=tilt_rad, height_m=height_m)


def _pose(position: NDArray[np.float64], turned: Matrix) -> Pose:
    """Return the pose of a flat thing whose axes in the camera frame are the columns of a matrix."""
    x, y, z = (float(each) for each in turned[:, 2])
    tilt, towards = math.acos(min(z, 1.0)), math.atan2(y, x)
    bare = Pose(position_m=tuple(position.tolist()), tilt_rad=tilt, tilt_towards_rad=towards)
    rest = bare.rotation().T @ turned
    return replace(bare, roll_rad=math.atan2(float(rest[1, 0]), float(rest[0, 0])))


def _about_right(angle: float) -> Matrix:
    """Return a turn about the axis to the right that looks up by an angle: down becomes (0, cos, -sin)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array(((1.0, 0.0, 0.0), (0.0, cosine, sine), (0.0, -sine, cosine)))


def _about_up(angle: float) -> Matrix:
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array(((cosine, 0.0, sine), (0.0, 1.0, 0.0), (-sine, 0.0, cosine)))


def _rolled(angle: float) -> Matrix:
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array(((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0)))
