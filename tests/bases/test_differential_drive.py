from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from stadimeter.bases.differential_drive import DifferentialDrive, Motion, WheelTicks

DRIVE = DifferentialDrive(track_width_m=0.16, ticks_per_metre=7000.0, max_wheel_mps=0.5, frame_s=0.033)
speeds = st.floats(-5, 5)


def test_straight_ahead_turns_both_wheels_alike() -> None:
    assert DRIVE.ticks(Motion(linear_mps=0.2, angular_radps=0.0)) == WheelTicks(left=46, right=46)


def test_a_turn_to_the_left_runs_the_right_wheel_forwards_and_the_left_one_backwards() -> None:
    assert DRIVE.ticks(Motion(linear_mps=0.0, angular_radps=1.0)) == WheelTicks(left=-18, right=18)


def test_what_is_returned_is_what_whole_ticks_do() -> None:
    ticks = DRIVE.ticks(Motion(linear_mps=0.2, angular_radps=0.0))
    assert DRIVE.motion(ticks).linear_mps == pytest.approx(46 / (7000 * 0.033))


def test_less_than_half_a_tick_stands_still() -> None:
    motion = DRIVE.motion(DRIVE.ticks(Motion(linear_mps=DRIVE.tick_mps * 0.49, angular_radps=0.0)))
    assert motion == Motion(linear_mps=0.0, angular_radps=0.0)


def test_a_limit_of_exactly_n_ticks_allows_n_ticks() -> None:
    for ticks in range(1, 200):
        drive = DifferentialDrive(
            track_width_m=0.16, ticks_per_metre=7000.0, max_wheel_mps=ticks / (7000 * 0.033), frame_s=0.033
        )
        assert drive.max_ticks == ticks


@given(speeds, speeds)
def test_no_wheel_is_ever_faster_than_its_limit(linear_mps: float, angular_radps: float) -> None:
    ticks = DRIVE.ticks(Motion(linear_mps=linear_mps, angular_radps=angular_radps))
    assert max(abs(ticks.left), abs(ticks.right)) <= DRIVE.max_ticks
    assert DRIVE.max_ticks * DRIVE.tick_mps <= DRIVE.max_wheel_mps * (1 + 1e-9)


@given(speeds, speeds)
def test_a_motion_within_the_limit_is_kept_to_half_a_tick(linear_mps: float, angular_radps: float) -> None:
    assume(abs(linear_mps) + abs(angular_radps) * 0.08 < 0.49)
    motion = DRIVE.motion(DRIVE.ticks(Motion(linear_mps=linear_mps, angular_radps=angular_radps)))
    assert motion.linear_mps == pytest.approx(linear_mps, abs=DRIVE.tick_mps / 2 + 1e-9)
    assert motion.angular_radps == pytest.approx(angular_radps, abs=DRIVE.tick_mps / 0.16 + 1e-9)


@given(st.floats(0.6, 5), st.floats(-20, 20))
def test_a_motion_over_the_limit_keeps_its_curve(linear_mps: float, angular_radps: float) -> None:
    motion = DRIVE.motion(DRIVE.ticks(Motion(linear_mps=linear_mps, angular_radps=angular_radps)))
    wanted = math.atan2(angular_radps * 0.08, linear_mps)
    assert math.atan2(motion.angular_radps * 0.08, motion.linear_mps) == pytest.approx(wanted, abs=0.02)


@given(st.integers(-115, 115), st.integers(-115, 115))
def test_ticks_to_a_motion_and_back_are_the_same_ticks(left: int, right: int) -> None:
    ticks = WheelTicks(left=left, right=right)
    assert DRIVE.ticks(DRIVE.motion(ticks)) == ticks
