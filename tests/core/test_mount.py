"""Places in the robot's frame."""

from __future__ import annotations

import math

import pytest

from stadimeter.core.camera_pose import Mount


def test_a_camera_in_the_middle_that_looks_ahead_has_its_axes_exchanged() -> None:
    assert Mount().in_robot((0.1, 0.2, 3.0)) == pytest.approx((3.0, -0.1, -0.2))


def test_a_camera_that_looks_down_sees_the_floor_at_height_zero() -> None:
    tilt = math.radians(-30)
    mount = Mount(x_m=0.12, y_m=-0.05, z_m=0.5, tilt_rad=tilt)
    on_axis_m = 0.5 / math.sin(-tilt)
    assert mount.in_robot((0.0, 0.0, on_axis_m)) == pytest.approx((0.12 + 0.5 / math.tan(-tilt), -0.05, 0.0))


def test_a_camera_that_is_turned_to_the_left_looks_along_y() -> None:
    mount = Mount(x_m=0.1, yaw_rad=math.pi / 2, z_m=0.3)
    assert mount.in_robot((0.5, 0.0, 2.0)) == pytest.approx((0.1 + 0.5, 2.0, 0.3))


def test_the_robot_s_axes_are_at_right_angles_at_any_tilt() -> None:
    x, y, z = Mount(yaw_rad=0.7).axes(-0.4)
    for one, other, product in ((x, y, 0), (y, z, 0), (x, z, 0), (x, x, 1), (y, y, 1), (z, z, 1)):
        assert sum(a * b for a, b in zip(one, other, strict=True)) == pytest.approx(product)
