from __future__ import annotations

import math

import pytest

from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.liveness import EgoMotion


def driven(
    linear_mps: float, angular_radps: float, seconds: float, wheels_mps: tuple[float, float] | None = None
) -> EgoMotion:
    """Return the motion after cycles of 20 ms with one command, perhaps with wheels that report how they roll."""
    ego = EgoMotion()
    for number in range(round(seconds / 0.02) + 1):
        at_s = 0.02 * number
        report = wheels_mps and BaseReport(at_s=at_s, left_m=wheels_mps[0] * at_s, right_m=wheels_mps[1] * at_s)
        command = TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=0.0)
        ego = ego.step(at_s, command, report or None)
    return ego


def test_without_reports_the_path_is_the_commanded_one() -> None:
    end = driven(0.5, 0.5, math.pi).path[-1]
    assert (end.x_m, end.y_m) == pytest.approx((1.0, 1.0), abs=0.01)
    assert end.heading_rad == pytest.approx(math.pi / 2, abs=0.02)


def test_wheels_that_report_count_and_not_the_command() -> None:
    assert driven(0.5, 0.0, 1.0, wheels_mps=(0.2, 0.2)).path[-1].travel_m == pytest.approx(0.2)


def test_a_robot_whose_wheels_stand_has_not_turned_whatever_is_commanded() -> None:
    assert driven(0.3, 1.0, 1.0, wheels_mps=(0.0, 0.0)).least_since(0.5, 1.0) == (0.0, 0.0)


def test_a_count_that_begins_anew_is_no_motion() -> None:
    ego = driven(0.3, 0.0, 1.0, wheels_mps=(0.3, 0.3))
    begun_anew = ego.step(1.02, None, BaseReport(at_s=1.02, left_m=-50.0, right_m=-50.0))
    assert begun_anew.path[-1].travel_m == ego.path[-1].travel_m


def test_of_every_lag_the_one_with_the_least_motion_counts() -> None:
    ego = driven(0.0, 0.0, 1.0)
    for number in range(1, 11):
        command = TwistCommand(output="base", linear_mps=1.0, angular_radps=-2.0, captured_at_s=0.0)
        ego = ego.step(1.0 + 0.02 * number, command, None)
    travel_m, turn_rad = ego.least_since(1.0, 1.2)
    assert travel_m == pytest.approx(0.0, abs=1e-9), "a motor may follow 0.2 s later"
    assert turn_rad == pytest.approx(0.0, abs=1e-9)
    assert ego.at(1.1).travel_m == pytest.approx(0.1)


def test_backwards_and_forwards_is_no_way() -> None:
    ego = EgoMotion()
    for number in range(100):
        speed_mps = 0.5 if number % 2 else -0.5
        command = TwistCommand(output="base", linear_mps=speed_mps, angular_radps=0.0, captured_at_s=0.0)
        ego = ego.step(0.02 * number, command, None)
    assert ego.least_since(1.0, 1.9)[0] < 0.02


def commanded(ego: EgoMotion, seconds: float, linear_mps: float, angular_radps: float) -> EgoMotion:
    begun_s = ego.path[-1].at_s
    for number in range(1, round(seconds / 0.02) + 1):
        command = TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=0.0)
        ego = ego.step(begun_s + 0.02 * number, command, None)
    return ego


def test_a_robot_that_drives_on_and_turns_is_ever_further_from_where_it_was() -> None:
    travel_m, turn_rad = driven(0.5, 0.5, 5.0).apart_since(1.0, 4.0)
    assert travel_m == pytest.approx(0.85 * 1.5)
    assert turn_rad == pytest.approx(0.85 * 1.5)


def test_after_a_way_to_and_fro_or_one_right_round_it_may_be_where_it_was() -> None:
    there_and_back = commanded(driven(0.5, 0.0, 4.0), 3.2, -0.5, 0.0)
    assert there_and_back.least_since(0.5, 7.0)[0] > 0.1
    assert there_and_back.apart_since(0.5, 7.0) == (0.0, 0.0)
    assert driven(0.2, 1.0, 6.5).apart_since(0.2, 6.4) == (0.0, 0.0)


def test_what_is_too_slow_to_count_may_have_moved_it_back() -> None:
    ego = commanded(driven(0.0, 0.25, 2.0), 3.0, 0.0, -0.19)
    assert ego.least_since(0.5, 5.0)[1] > 0.3
    assert ego.apart_since(0.5, 5.0) == (0.0, 0.0)


def test_the_path_is_forgotten_after_a_while() -> None:
    assert len(driven(0.5, 0.0, 60.0).path) < 1400
