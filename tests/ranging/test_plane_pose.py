"""Poses of flat rectangles from exact and from shaken corners."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from stadimeter.detectors.sheet.candidates import rectangle_fit
from stadimeter.ranging.plane_pose import (
    RectanglePose,
    distance_share,
    doubt_share,
    plane_poses,
    rectangle,
    rectangle_poses,
)
from support.scenes.plane import Pose

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]


A4 = rectangle(0.297, 0.210)
SIGMA = 0.05 / 600


def directions_of(pose: Pose, corners_m: np.ndarray = A4) -> np.ndarray:
    placed = pose.placed(corners_m[:, :2] * (1, -1))
    return placed[:, :2] / placed[:, 2:]


@given(
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.4, 0.4),
    z=st.floats(0.3, 6.0),
    tilt=st.floats(0, 1.2),
    towards=st.floats(0, 2 * math.pi),
    roll=st.floats(-math.pi, math.pi),
)
@example(x=0.0, y=0.0, z=1.0, tilt=0.0, towards=0.0, roll=0.0)
@example(x=0.4, y=0.3, z=2.0, tilt=0.0, towards=0.0, roll=0.0)
@example(x=0.4, y=-0.3, z=2.0, tilt=0.0, towards=0.0, roll=math.pi)
def test_exact_corners_give_the_exact_place_and_tilt(x, y, z, tilt, towards, roll) -> None:
    place = np.array((x * z, y * z, z))
    pose = Pose(position_m=tuple(place.tolist()), tilt_rad=tilt, tilt_towards_rad=towards, roll_rad=roll)
    best = plane_poses(A4, directions_of(pose))[0]
    assert np.linalg.norm(best.position_m - place) < 1e-4 * np.linalg.norm(place)
    normal = pose.rotation()[:, 2]
    true_tilt = math.acos(min(abs(float(normal @ place)) / float(np.linalg.norm(place)), 1.0))
    assert best.tilt_rad == pytest.approx(true_tilt, abs=0.02)


def test_corners_that_are_no_rectangle_in_front_give_no_pose_or_a_bad_one() -> None:
    on_a_line = np.array(((0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.3, 0.0)))
    assert all(not pose.misfit < 1e-3 for pose in plane_poses(A4, on_a_line))


@pytest.mark.parametrize("pose", [Pose(position_m=(0.2, 0.1, 1.5)), Pose(position_m=(0, 0, 2), tilt_rad=0.9)])
def test_shaken_corners_miss_the_distance_by_as_much_as_is_stated(pose: Pose) -> None:
    rng = np.random.default_rng(1)
    exact = directions_of(pose)
    true_m = math.hypot(*pose.position_m)
    poses = [plane_poses(A4, exact + rng.normal(0, SIGMA, (4, 2)))[0] for _ in range(400)]
    off = np.array([each.distance_m / true_m - 1 for each in poses])
    stated = distance_share(poses[0], A4, SIGMA)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(stated, rel=0.2)


def test_the_doubt_is_the_difference_in_distance_weighted_with_the_other_poses_probability() -> None:
    best = RectanglePose((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 2.0), misfit=1e-4)
    other = best._replace(position_m=(0.0, 0.0, 2.1), misfit=2e-4)
    # Eight coordinates: the other one is worse by 8 · (2² - 1²) = 24 squares of a standard deviation of 1e-4.
    probability = 1 / (1 + math.exp(24 / 2))
    assert doubt_share((best, other), 1e-4) == pytest.approx(math.sqrt(probability) * 0.05)
    assert doubt_share((best, other._replace(misfit=1e-4)), 1e-4) == pytest.approx(math.sqrt(0.5) * 0.05)
    assert doubt_share((best,), 1e-4) == 0


@given(
    z=st.floats(0.4, 3.0), tilt=st.floats(0, 1.1), towards=st.floats(0, 2 * math.pi), roll=st.floats(-math.pi, math.pi)
)
def test_a_picture_of_the_rectangle_fits_it_and_one_of_another_does_not(z, tilt, towards, roll) -> None:
    pose = Pose(position_m=(0.1 * z, -0.1 * z, z), tilt_rad=tilt, tilt_towards_rad=towards, roll_rad=roll)
    seen = directions_of(pose)
    for turned in range(4):
        assert rectangle_fit(np.roll(seen, turned, axis=0)[None], 0.297 / 0.210).misfit[0] < 1e-6
    square = directions_of(pose, rectangle(0.297, 0.297))
    assert rectangle_fit(square[None], 0.297 / 0.210).misfit[0] > 0.1 / 600


# The two poses of a rectangle, against pictures of rectangles whose pose is known.

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
