"""Tags at known places in a room, and a camera whose pose there is known exactly."""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Landmarks, PlacedTag
from support.scenes.plane import Pose, TagTarget
from support.scenes.scene import Scene

Floats = NDArray[np.float64]

CAMERA = CameraModel.with_focal_length(1000.0, 1280, 960)
TAG_M = 0.10
CLEAR_PX = 110
"""The centre of a tag keeps this far from the borders of its quarter of the picture; its paper has 125 px at 1 m."""

MOST_FACING_AWAY_RAD = math.radians(50)


RANGE_M = (1.0, 4.0)
"""Between which distances the tags are on the whole; each is up to 15 % nearer or further."""


class PlacedScene(Struct, frozen=True, kw_only=True, eq=False):
    """A picture of tags at known places.

    Attributes:
        scene: What is rendered.
        landmarks: The tags as a configuration says that they are.
        position_m: Where the camera is in the room.
        turn: Its axes there as columns: x right, y down, z forward.
        distance_m: The mean distance of the tags.
    """

    scene: Scene
    landmarks: Landmarks
    position_m: Floats
    turn: Floats
    distance_m: float


def placed_scene(seed: int, place_sigma_m: float = 0.0, facing_sigma_rad: float = 0.0) -> PlacedScene:
    """Draw a camera and tags of 10 cm before it, one in each quarter of the picture, which all hang upright.

    Args:
        seed: The scene.
        place_sigma_m: By how much each coordinate of a tag is off from what its configuration says.
        facing_sigma_rad: By how much its turn about each axis is.

    Returns:
        The scene, with all that is known of it.
    """
    rng = np.random.default_rng((seed, 90))
    yaw, tilt = rng.uniform(-math.pi, math.pi), rng.uniform(-0.25, 0.25)
    position, turn = rng.uniform((-5, -5, 0.2), (5, 5, 1.5)), _turn(yaw, tilt, rng.uniform(-0.05, 0.05))
    distance = float(np.exp(rng.uniform(*np.log(RANGE_M))))
    targets, placed = [], []
    for quarter in rng.permutation(4):
        left, top = 640 * (quarter % 2), 480 * (quarter // 2)
        at_px = rng.uniform((left + CLEAR_PX, top + CLEAR_PX), (left + 640 - CLEAR_PX, top + 480 - CLEAR_PX))
        depth = distance * rng.uniform(0.85, 1.15)
        centre = position + turn @ np.array((*(at_px - (CAMERA.cx_px, CAMERA.cy_px)) / CAMERA.fx_px, 1.0)) * depth
        back = position - centre
        facing = math.atan2(back[1], back[0]) + rng.uniform(-MOST_FACING_AWAY_RAD, MOST_FACING_AWAY_RAD)
        tag = PlacedTag(number=int(quarter) + 10, side_m=TAG_M, position_m=tuple(centre), facing_rad=facing)
        targets.append(_target(tag, position, turn))
        placed.append(_misplaced(tag, rng, place_sigma_m, facing_sigma_rad))
        if facing_sigma_rad:
            wrong = cv2.Rodrigues(rng.normal(0, facing_sigma_rad, 3))[0]
            targets[-1] = _target(tag, position, turn, wrong)
    landmarks = Landmarks(tags=tuple(placed), place_sigma_m=place_sigma_m, facing_sigma_rad=facing_sigma_rad)
    scene = Scene(camera=CAMERA, target=targets[0], others=tuple(targets[1:]), seed=seed)
    return PlacedScene(scene=scene, landmarks=landmarks, position_m=position, turn=turn, distance_m=distance)


def moved(scene: PlacedScene, away_m: float) -> PlacedScene:
    """Return a scene whose first tag is not where its configuration says, by a distance along one axis."""
    first, *others = scene.landmarks.tags
    x, y, z = first.position_m
    first = replace(first, position_m=(x, y, z + away_m))
    return replace(scene, landmarks=replace(scene.landmarks, tags=(first, *others)))


def _misplaced(tag: PlacedTag, rng: np.random.Generator, sigma_m: float, sigma_rad: float) -> PlacedTag:
    x, y, z = (rng.normal(tag.position_m, sigma_m) if sigma_m else np.array(tag.position_m)).tolist()
    return replace(tag, position_m=(x, y, z))


def _turn(yaw: float, tilt: float, roll: float) -> Floats:
    """Return the camera's axes in the room."""
    forward = np.array((math.cos(yaw) * math.cos(tilt), math.sin(yaw) * math.cos(tilt), math.sin(tilt)))
    level = np.array((math.sin(yaw), -math.cos(yaw), 0.0))
    down = np.cross(forward, level)
    right = math.cos(roll) * level + math.sin(roll) * down
    return np.column_stack((right, np.cross(forward, right), forward))


def _target(tag: PlacedTag, position: Floats, turn: Floats, wrong: Floats | None = None) -> TagTarget:
    """Return what is drawn of a tag, turned a little from where it should be."""
    normal = np.array(tag.normal)
    up = np.array((0.0, 0.0, 1.0))
    axes = np.column_stack((np.cross(up, normal), -up, -normal))  # as drawn: x right, y down, z away
    seen = turn.T @ (axes if wrong is None else wrong @ axes)
    x, y, z = (turn.T @ (np.array(tag.position_m) - position)).tolist()
    tilt, towards = math.acos(min(1.0, seen[2, 2])), math.atan2(seen[1, 2], seen[0, 2])
    upright = Pose(position_m=(x, y, z), tilt_rad=tilt, tilt_towards_rad=towards).rotation()
    rolled = upright.T @ seen
    pose = Pose(
        position_m=(x, y, z),
        tilt_rad=tilt,
        tilt_towards_rad=towards,
        # OpenCV draws AprilTags upside down, by half a turn against the pictures that their authors publish.
        roll_rad=math.atan2(rolled[1, 0], rolled[0, 0]) + math.pi,
    )
    return TagTarget(pose=pose, side_m=tag.side_m, number=tag.number)
