"""Random scenes of the kinds that the benchmarks measure. A seed stands for one clean scene.

Seeds from `TUNING_SEEDS` are for choosing thresholds and fitting constants; those from `REPORT_SEEDS` are for figures
that are published. Nothing may be chosen by looking at the latter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.simulation.camera import Vector
from support.scenes.backdrop import Backdrop, ClutterBackdrop, PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.scene import Scene
from support.scenes.target import Lens, Target

TUNING_SEEDS = range(1_000_000)
REPORT_SEEDS = range(1_000_000, 2_000_000)

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
MARGIN_PX = 6.0
"""A target keeps this far from the border of the picture."""

TENNIS_M, LARGE_BALL_M = 0.067, 0.20
TENNIS_RANGE_M, LARGE_BALL_RANGE_M = (0.3, 4.0), (0.45, 6.0)
SHEET_M = (0.297, 0.210)
SHEET_RANGE_M = (0.6, 4.0)
GREATEST_ROLL_RAD = 0.6
TAG_M, TAG_FAMILY, TAGS = 0.10, "apriltag-36h11", 587
DISC_M = 0.12
DISC_RANGE_M = (0.3, 3.0)
MOST_ATTEMPTS = 1000

T = TypeVar("T", bound=Target)


def ball_scene(seed: int, camera: CameraModel = CAMERA) -> Scene:
    """Draw a ball on clutter: an even seed a tennis ball 0.3 to 4 m away, an odd one a 20 cm ball 0.45 to 6 m away.

    Args:
        seed: The scene.
        camera: The camera.

    Returns:
        The scene, with the ball whole in the picture.
    """
    rng = np.random.default_rng((seed, 20))
    diameter, (near, far) = (TENNIS_M, TENNIS_RANGE_M) if seed % 2 == 0 else (LARGE_BALL_M, LARGE_BALL_RANGE_M)
    lamp = (float(rng.uniform(-1, 1)), float(rng.uniform(-1, -0.2)), float(rng.uniform(-1, -0.2)))
    target = first_whole(
        lambda: BallTarget(position_m=_place(rng, camera, _depth_m(rng, near, far)), diameter_m=diameter, light=lamp),
        camera,
    )
    return Scene(camera=camera, target=target, seed=seed)


def sheet_scene(seed: int, tilt_rad: float, *, plain: bool = False, camera: CameraModel = CAMERA) -> Scene:
    """Draw a sheet of A4 0.6 to 4 m away, rolled by up to 34 degrees, on a plain wall or on clutter.

    Args:
        seed: The scene.
        tilt_rad: Angle between its normal and the optical axis; which way it is tilted follows from the seed.
        plain: Whether it is before a plain wall, darker than the sheet.
        camera: The camera.

    Returns:
        The scene, with the sheet whole in the picture.
    """
    rng = np.random.default_rng((seed, 21))
    wall = _wall(rng)
    width_m, height_m = SHEET_M
    target = first_whole(
        lambda: SheetTarget(pose=_pose(rng, camera, SHEET_RANGE_M, tilt_rad), width_m=width_m, height_m=height_m),
        camera,
    )
    return Scene(camera=camera, target=target, seed=seed, backdrop=wall if plain else ClutterBackdrop())


def disc_scene(seed: int, tilt_rad: float, *, plain: bool = False, camera: CameraModel = CAMERA) -> Scene:
    """Draw a white disc of 12 cm 0.3 to 3 m away.

    Args:
        seed: The scene.
        tilt_rad: Angle between its normal and the optical axis; which way it is tilted follows from the seed.
        plain: Whether it is before a plain wall, darker than the disc.
        camera: The camera.

    Returns:
        The scene, with the disc whole in the picture.
    """
    rng = np.random.default_rng((seed, 22))
    wall = _wall(rng)
    target = first_whole(lambda: DiscTarget(pose=_pose(rng, camera, DISC_RANGE_M, tilt_rad), diameter_m=DISC_M), camera)
    return Scene(camera=camera, target=target, seed=seed, backdrop=wall if plain else ClutterBackdrop())


def tag_scene(seed: int, side_px: float, tilt_rad: float, camera: CameraModel = CAMERA) -> Scene:
    """Draw a tag of 10 cm, AprilTag 36h11, on clutter, as far away as makes it that large.

    Args:
        seed: The scene; the tag's number is the remainder of it by `TAGS`.
        side_px: How long a side of its black square appears when it is not tilted.
        tilt_rad: Angle between its normal and the optical axis; which way it is tilted follows from the seed.
        camera: The camera.

    Returns:
        The scene, with the tag and its paper whole in the picture.
    """
    rng = np.random.default_rng((seed, 23))
    depth = camera.fx_px * TAG_M / side_px
    target = first_whole(
        lambda: TagTarget(
            pose=_pose(rng, camera, (depth, depth), tilt_rad), side_m=TAG_M, family=TAG_FAMILY, number=seed % TAGS
        ),
        camera,
    )
    return Scene(camera=camera, target=target, seed=seed)


def empty_scene(seed: int, distractors: int = 0, camera: CameraModel = CAMERA) -> Scene:
    """Draw clutter without a target.

    Args:
        seed: The scene.
        distractors: How many angular shapes of a tennis ball's colour lie in it.
        camera: The camera.

    Returns:
        The scene.
    """
    return Scene(camera=camera, target=None, seed=seed, backdrop=ClutterBackdrop(distractors=distractors))


def _wall(rng: np.random.Generator) -> Backdrop:
    grey = int(rng.integers(40, 131))
    return PlainBackdrop(bgr=(grey, grey + 5, grey + 10))


def _depth_m(rng: np.random.Generator, near_m: float, far_m: float) -> float:
    """Return a depth evenly spread over its logarithm."""
    return float(np.exp(rng.uniform(math.log(near_m), math.log(far_m))))


def _place(rng: np.random.Generator, camera: CameraModel, depth_m: float) -> Vector:
    """Return a point evenly spread over the picture."""
    x, y = camera.direction(float(rng.uniform(0, camera.width_px)), float(rng.uniform(0, camera.height_px)))
    return (x * depth_m, y * depth_m, depth_m)


def _pose(rng: np.random.Generator, camera: CameraModel, range_m: tuple[float, float], tilt_rad: float) -> Pose:
    return pose_at(rng, camera, _depth_m(rng, *range_m), tilt_rad, GREATEST_ROLL_RAD)


def pose_at(
    rng: np.random.Generator, camera: CameraModel, depth_m: float, tilt_rad: float, most_roll_rad: float = math.pi
) -> Pose:
    """Return a pose so deep, anywhere in the picture, tilted to any side."""
    return Pose(
        position_m=_place(rng, camera, depth_m),
        tilt_rad=tilt_rad,
        tilt_towards_rad=float(rng.uniform(0, 2 * math.pi)),
        roll_rad=float(rng.uniform(-most_roll_rad, most_roll_rad)),
    )


def first_whole(make: Callable[[], T], camera: CameraModel) -> T:
    """Return the first target that is drawn whole in the picture."""
    for _ in range(MOST_ATTEMPTS):
        if is_whole(target := make(), camera):
            return target
    raise ValueError(f"no such target fits the picture: {target}")


def is_whole(target: Target, camera: CameraModel) -> bool:
    """Return whether all of a target is in the picture, and not at its border."""
    points = target.extent_m()
    if (points[:, 2] <= 0).any():
        return False
    places = Lens(camera=camera).project(points)
    last = np.array((camera.width_px, camera.height_px)) - 1 - MARGIN_PX
    return bool(((places >= MARGIN_PX) & (places <= last)).all())
