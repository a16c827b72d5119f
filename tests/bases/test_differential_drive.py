from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from stadimeter.bases.differential_drive import DifferentialDrive, Motion, WheelSpeeds

DRIVE = DifferentialDrive(track_width_m=0.16, max_wheel_mps=0.5)
speeds = st.floats(-5, 5)


def motion(linear_mps: float, angular_radps: float) -> Motion:
    return Motion(linear_mps=linear_mps, angular_radps=angular_radps)


def test_straight_ahead_turns_both_wheels_alike() -> None:
    assert DRIVE.wheels(motion(0.2, 0.0)) == WheelSpeeds(left_mps=0.2, right_mps=0.2)


def test_a_turn_to_the_left_runs_the_right_wheel_forwards_and_the_left_one_backwards() -> None:
    assert DRIVE.wheels(motion(0.0, 1.0)) == WheelSpeeds(left_mps=-0.08, right_mps=0.08)


@given(speeds, speeds)
def test_no_wheel_is_ever_faster_than_its_limit(linear_mps: float, angular_radps: float) -> None:
    wheels = DRIVE.wheels(motion(linear_mps, angular_radps))
    assert max(abs(wheels.left_mps), abs(wheels.right_mps)) <= DRIVE.max_wheel_mps * (1 + 1e-9)


@given(speeds, speeds)
def test_a_motion_within_the_limit_is_kept(linear_mps: float, angular_radps: float) -> None:
    assume(abs(linear_mps) + abs(angular_radps) * 0.08 < 0.5)
    kept = DRIVE.motion(DRIVE.wheels(motion(linear_mps, angular_radps)))
    assert (kept.linear_mps, kept.angular_radps) == pytest.approx((linear_mps, angular_radps), abs=1e-9)


@given(st.floats(0.6, 5), st.floats(-20, 20))
def test_a_motion_over_the_limit_keeps_its_curve(linear_mps: float, angular_radps: float) -> None:
    kept = DRIVE.motion(DRIVE.wheels(motion(linear_mps, angular_radps)))
    wanted = math.atan2(angular_radps * 0.08, linear_mps)
    assert math.atan2(kept.angular_radps * 0.08, kept.linear_mps) == pytest.approx(wanted, abs=1e-6)
