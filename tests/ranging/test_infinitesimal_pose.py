"""The two poses of a rectangle, against pictures of rectangles whose pose is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.ranging.plane_pose import misfit, rectangle_poses

pytestmark = pytest.mark.vision

HALF_WIDTH_M, HALF_HEIGHT_M = 0.06, 0.04
CORNERS_M = np.array(
    [
        (-HALF_WIDTH_M, HALF_HEIGHT_M, 0),
        (HALF_WIDTH_M, HALF_HEIGHT_M, 0),
        (HALF_WIDTH_M, -HALF_HEIGHT_M, 0),
        (-HALF_WIDTH_M, -HALF_HEIGHT_M, 0),
    ]
)
FACING = np.diag((1.0, -1.0, -1.0))
"""Facing the camera, upright: its top is up, which is where y is smaller."""


def turned(tilt_rad: float, towards_rad: float, roll_rad: float) -> np.ndarray:
    """Return the axes of a rectangle that faces the camera, was rolled, and then tilted about an axis in its plane."""
    x, y = math.cos(towards_rad), math.sin(towards_rad)
    cross = np.array(((0, 0, y), (0, 0, -x), (-y, x, 0)))
    tilt = np.eye(3) + math.sin(tilt_rad) * cross + (1 - math.cos(tilt_rad)) * cross @ cross
    c, s = math.cos(roll_rad), math.sin(roll_rad)
    return FACING @ tilt @ np.array(((c, -s, 0), (s, c, 0), (0, 0, 1)))


def seen_from(rotation: np.ndarray, position_m: np.ndarray) -> list[list[float]]:
    placed = CORNERS_M @ rotation.T + position_m
    return (placed[:, :2] / placed[:, 2:]).tolist()


@given(
    tilt_rad=st.floats(0, 1.2),
    towards_rad=st.floats(-math.pi, math.pi),
    roll_rad=st.floats(-math.pi, math.pi),
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.5, 0.5),
    depth_m=st.floats(0.3, 5.0),
)
def test_the_true_pose_is_the_first_and_explains_the_corners(tilt_rad, towards_rad, roll_rad, x, y, depth_m) -> None:
    rotation, position_m = turned(tilt_rad, towards_rad, roll_rad), np.array((x, y, 1.0)) * depth_m
    poses = rectangle_poses(HALF_WIDTH_M, HALF_HEIGHT_M, seen_from(rotation, position_m))
    assert poses[0].misfit < 1e-9
    assert poses[0].position_m == pytest.approx(position_m.tolist(), abs=1e-4 * depth_m)
    for pose in poses:
        right, up = np.array(pose.right), np.array(pose.up)
        assert (right @ right, up @ up, right @ up) == pytest.approx((1, 1, 0), abs=1e-7)


def test_the_two_poses_are_mirrored_about_the_line_of_sight() -> None:
    rotation = turned(0.6, 0.4, 0.2)
    better, worse = rectangle_poses(HALF_WIDTH_M, HALF_HEIGHT_M, seen_from(rotation, np.array((0.0, 0.0, 2.0))))
    normals = [np.cross(pose.right, pose.up) for pose in (better, worse)]
    assert normals[0] == pytest.approx(rotation[:, 2], abs=1e-6)
    assert normals[1] == pytest.approx(rotation[:, 2] * (-1, -1, 1), abs=0.05)
    assert worse.misfit > 100 * better.misfit


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.4, 0.0), (-0.3, 0.25)])
def test_something_seen_exactly_from_the_front_has_both_poses(place: tuple[float, float]) -> None:
    """In OpenCV's closed form, zero is divided by zero there."""
    position_m = np.array((*place, 1.0)) * 1.5
    poses = rectangle_poses(HALF_WIDTH_M, HALF_HEIGHT_M, seen_from(FACING, position_m))
    assert len(poses) == 2
    assert poses[0].position_m == pytest.approx(position_m.tolist(), abs=1e-9)


@pytest.mark.parametrize(
    "seen",
    [
        [(0.1, 0.1)] * 4,
        [(0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.3, 0.0)],
        [(0.0, 0.0), (0.1, 0.0), (0.0, 0.1), (0.1, 0.1)],
        [(math.nan, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)],
    ],
    ids=["a point", "a line", "crossed", "not a number"],
)
def test_corners_of_no_rectangle_have_no_pose(seen: list[tuple[float, float]]) -> None:
    assert rectangle_poses(HALF_WIDTH_M, HALF_HEIGHT_M, seen) == []


def test_a_corner_behind_the_camera_fits_nothing() -> None:
    assert math.isinf(misfit((1, 0, 0), (0, 0, 1), (0, 0, 0.01), CORNERS_M.tolist(), [(0.0, 0.0)] * 4))
