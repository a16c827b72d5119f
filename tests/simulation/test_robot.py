from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.errors import CommandRangeError, DriverError
from stadimeter.simulation.motion import MEMORY, DifferentialRobot, Pose
from stadimeter.testing.rig import ManualClock

TRACK_M = 0.2
speeds = st.floats(-1.0, 1.0)
times = st.floats(0.01, 10.0)


def robot_at(x_m: float = 0.0, y_m: float = 0.0, heading_rad: float = 0.0) -> tuple[DifferentialRobot, ManualClock]:
    clock = ManualClock(50.0)
    start = Pose(x_m=x_m, y_m=y_m, heading_rad=heading_rad)
    return DifferentialRobot(track_width_m=TRACK_M, ticks_per_metre=1000.0, start=start, clock=clock), clock


def figures(pose: Pose) -> tuple[float, float, float]:
    return pose.x_m, pose.y_m, pose.heading_rad


def test_equal_wheels_drive_straight_ahead() -> None:
    robot, clock = robot_at(heading_rad=math.pi / 2)
    robot.drive_wheels(0.5, 0.5)
    clock.advance_s(4.0)
    assert figures(robot.pose) == pytest.approx((0.0, 2.0, math.pi / 2))
    assert robot.ticks == (2000, 2000)


def test_a_quarter_of_a_circle_to_the_left_ends_beside_its_centre() -> None:
    robot, clock = robot_at()
    robot.drive_wheels(0.45, 0.55)
    clock.advance_s(math.pi / 2 / 0.5)
    assert figures(robot.pose) == pytest.approx((1.0, 1.0, math.pi / 2))


def test_a_whole_circle_comes_back_in_many_steps_as_in_one() -> None:
    robot, clock = robot_at(3.0, -1.0, 0.7)
    for step in range(1000):
        robot.drive_wheels(0.3, 0.5 + (step % 2) * 1e-15)  # a change each time, so that each step begins a new arc
        clock.advance_s(2 * math.pi / 1000)
    assert figures(robot.pose) == pytest.approx((3.0, -1.0, 0.7 + 2 * math.pi), abs=1e-9)


@given(left=speeds, right=speeds, heading=st.floats(-4, 4), seconds=times)
def test_driving_backwards_the_same_way_comes_home(left: float, right: float, heading: float, seconds: float) -> None:
    robot, clock = robot_at(1.0, 2.0, heading)
    robot.drive_wheels(left, right)
    clock.advance_s(seconds)
    robot.drive_wheels(-left, -right)
    clock.advance_s(seconds)
    assert figures(robot.pose) == pytest.approx((1.0, 2.0, heading), abs=1e-9)


@given(left=speeds, right=speeds, seconds=times, share=st.floats(0.0, 1.0))
def test_the_way_does_not_depend_on_when_it_is_asked_about(
    left: float, right: float, seconds: float, share: float
) -> None:
    robot, clock = robot_at()
    robot.drive_wheels(left, right)
    ahead = robot.pose_at(50.0 + seconds * share)
    clock.advance_s(seconds)
    robot.drive_wheels(0.0, 0.0)
    assert figures(robot.pose_at(50.0 + seconds * share)) == pytest.approx(figures(ahead), abs=1e-12)


@given(left=speeds, right=speeds, seconds=times)
def test_a_robot_moves_no_further_than_its_wheels(left: float, right: float, seconds: float) -> None:
    robot, clock = robot_at()
    robot.drive_wheels(left, right)
    clock.advance_s(seconds)
    assert math.hypot(robot.pose.x_m, robot.pose.y_m) <= abs(left + right) / 2 * seconds + 1e-9
    assert robot.pose.heading_rad == pytest.approx((right - left) / TRACK_M * seconds)


def test_wheels_stop_by_themselves_when_told_until_when() -> None:
    robot, clock = robot_at()
    robot.drive_wheels(0.5, 0.5, until_s=52.0)
    clock.advance_s(1.0)
    assert robot.wheels_mps == (0.5, 0.5)
    clock.advance_s(9.0)
    assert robot.wheels_mps == (0.0, 0.0)
    assert figures(robot.pose) == pytest.approx((1.0, 0.0, 0.0))


def test_past_poses_are_remembered() -> None:
    robot, clock = robot_at()
    robot.drive_wheels(0.5, 0.5)
    clock.advance_s(1.0)
    robot.drive_wheels(-0.1, 0.1)
    clock.advance_s(1.0)
    assert figures(robot.pose_at(49.0)) == (0.0, 0.0, 0.0)
    assert figures(robot.pose_at(50.5)) == pytest.approx((0.25, 0.0, 0.0))
    assert figures(robot.pose_at(51.5)) == pytest.approx((0.5, 0.0, 0.5))


def test_what_is_too_long_ago_is_an_error_and_no_guess() -> None:
    robot, clock = robot_at()
    for step in range(MEMORY + 10):
        robot.drive_wheels(0.1, 0.1 + step * 1e-4)
        clock.advance_s(0.01)
    with pytest.raises(DriverError, match=r"remembers its way back to 50\.1"):
        robot.pose_at(50.05)


@pytest.mark.parametrize("speed", [math.nan, math.inf, -math.inf])
def test_wheels_refuse_what_is_not_a_speed(speed: float) -> None:
    robot, _ = robot_at()
    with pytest.raises(CommandRangeError):
        robot.drive_wheels(speed, 0.0)
    assert robot.wheels_mps == (0.0, 0.0)


def test_the_time_to_stop_must_be_a_number() -> None:
    robot, _ = robot_at()
    with pytest.raises(CommandRangeError):
        robot.drive_wheels(0.1, 0.1, until_s=math.nan)
