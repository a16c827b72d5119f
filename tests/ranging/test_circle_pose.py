"""The two poses of a circle that is seen as an ellipse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.ranging.flat import circle_poses, cone_through
from support.scenes.plane import Pose

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

DIAMETER_M = 0.12
ANGLES = np.linspace(0, 2 * math.pi, 48, endpoint=False)
RIM_M = DIAMETER_M / 2 * np.column_stack((np.cos(ANGLES), np.sin(ANGLES)))

PLACES = {
    "x": st.floats(-0.6, 0.6),
    "y": st.floats(-0.5, 0.5),
    "z": st.floats(0.2, 20.0),
    "tilt": st.floats(0, 1.2),
    "towards": st.floats(0, 2 * math.pi),
}


def rim(pose: Pose) -> np.ndarray:
    placed = pose.placed(RIM_M)
    return placed[:, :2] / placed[:, 2:]


def seen_at(x, y, z, tilt, towards):
    pose = Pose(position_m=(x * z, y * z, z), tilt_rad=tilt, tilt_towards_rad=towards)
    return pose, circle_poses(cone_through(rim(pose)), DIAMETER_M)


@given(**PLACES)
def test_the_distance_of_a_circle_is_exact_at_any_tilt(x, y, z, tilt, towards) -> None:
    pose, found = seen_at(x, y, z, tilt, towards)
    distance_m = math.hypot(*pose.position_m)
    assert [each.distance_m for each in found.poses] == pytest.approx([distance_m] * 2, rel=1e-6)


@given(**PLACES)
def test_one_of_the_poses_is_the_true_one(x, y, z, tilt, towards) -> None:
    pose, found = seen_at(x, y, z, tilt, towards)
    # Near face on the tilt goes with the root of a difference of eigenvalues, and so do its rounding errors.
    off_m = min(math.dist(each.position_m, pose.position_m) for each in found.poses)
    assert off_m < 2e-4 * DIAMETER_M + 1e-6 * z
    toward_camera = -pose.rotation()[:, 2]
    facing = toward_camera if toward_camera @ pose.position_m < 0 else -toward_camera
    assert max(float(each.normal @ facing) for each in found.poses) > 1 - 1e-4


@given(**PLACES)
def test_both_poses_explain_the_same_outline(x, y, z, tilt, towards) -> None:
    pose, found = seen_at(x, y, z, tilt, towards)
    cone = cone_through(rim(pose))
    for each in found.poses:
        first = np.cross(each.normal, (0.6, 0.8, 0.0))
        first /= np.linalg.norm(first)
        axes = np.column_stack((first, np.cross(each.normal, first)))
        rays = RIM_M @ axes.T + each.position_m
        rays /= rays[:, 2:]
        misfit = np.einsum("ni,ij,nj->n", rays, cone, rays)
        assert np.abs(misfit).max() < 1e-5, "the cone is 1 or so a radius outside its rim"


@given(**PLACES)
def test_both_poses_are_turned_away_by_the_same_angle(x, y, z, tilt, towards) -> None:
    _, found = seen_at(x, y, z, tilt, towards)
    one, other = found.poses
    assert one.tilt_rad == pytest.approx(other.tilt_rad, abs=1e-6)
    assert found.tilt_rad == one.tilt_rad
    middle = (one.position_m + other.position_m) / 2
    assert middle / np.linalg.norm(middle) == pytest.approx(found.axis, abs=1e-9)


def test_scattered_points_give_the_cone_that_fits_them_best() -> None:
    pose = Pose(position_m=(0.1, 0.0, 1.0), tilt_rad=0.6)
    shaken = rim(pose) + np.random.default_rng(4).normal(0, 1e-4, (len(RIM_M), 2))
    found = circle_poses(cone_through(shaken), DIAMETER_M)
    assert found.distance_m == pytest.approx(math.hypot(0.1, 1.0), rel=2e-3)


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 2)),
        np.zeros((20, 2)),
        np.full((20, 2), np.nan),
        np.column_stack((np.arange(20), np.arange(20))) / 20,
        np.column_stack((ANGLES - 3, 1 / (ANGLES - 3))),
    ],
    ids=["none", "one place", "not finite", "a line", "a hyperbola"],
)
def test_points_on_no_ellipse_give_no_cone(points) -> None:
    assert cone_through(points) is None


def test_a_cone_that_is_none_has_no_pose() -> None:
    assert circle_poses(np.diag((1.0, 1.0, 1.0)), DIAMETER_M) is None
