"""Liveness: pictures and targets that do not go with the way that the robot drives."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.liveness import (
    FALSE_ALARM,
    EgoMotion,
    LivenessState,
    TargetInnovation,
    step_innovation,
    step_liveness,
)
from stadimeter.core.observation import FlowSince, FrameStamp, Observation, PictureFlow
from support.each_case import each_case
from support.observing import measured

CYCLE_S = 1 / 30


def flow_since(at_s: float, age_s: float, shift_px: float, sigma_px2: float = 0.001) -> FlowSince:
    return FlowSince(
        since_s=at_s - age_s,
        step_s=CYCLE_S,
        focal_px=150.0,
        aside_px=40.0,
        blocks=40,
        shift2_px2=shift_px**2,
        sigma_px2=sigma_px2,
    )


def found_at_s(
    linear_mps: float, angular_radps: float, shift_px: float, *, sigma_px2: float = 0.001, seconds: float = 3.0
) -> float | None:
    """Return how long after the wheels began to turn a picture is found to stand still; None for never.

    Args:
        shift_px: What the picture shows of the motion, since each of the earlier ones.
    """
    state = LivenessState()
    for number in range(round(seconds / CYCLE_S)):
        at_s = number * CYCLE_S
        command = TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=at_s)
        looks = tuple(flow_since(at_s, age_s, shift_px, sigma_px2) for age_s in (0.13, 0.3, 1.0) if at_s >= age_s)
        observation = Observation(
            now_s=at_s,
            frame=FrameStamp(sequence=number, captured_at_s=at_s),
            flow=PictureFlow(textured=0.6, since=looks),
        )
        state, cause = step_liveness(state, observation, command, is_new=True)
        if cause:
            assert cause.startswith("the picture stands still while the wheels turn (")
            return at_s
    return None


@pytest.mark.parametrize(
    ("linear_mps", "angular_radps", "within_s"),
    [(0.3, 0.0, 0.45), (0.2, 0.0, 0.55), (0.0, 1.0, 0.45), (0.05, 0.0, 1.3)],
)
def test_a_picture_that_stands_still_while_the_wheels_turn_is_found(
    linear_mps: float, angular_radps: float, within_s: float
) -> None:
    assert (found_at_s(linear_mps, angular_radps, shift_px=0.0) or 9.9) <= within_s


@pytest.mark.parametrize(("linear_mps", "angular_radps"), [(0.3, 0.0), (0.1, 0.0), (0.0, 1.0), (0.3, 0.5)])
def test_a_picture_that_flows_is_believed(linear_mps: float, angular_radps: float) -> None:
    assert found_at_s(linear_mps, angular_radps, shift_px=0.5) is None


def test_below_the_least_motion_nothing_is_claimed() -> None:
    assert found_at_s(0.02, 0.0, shift_px=0.0, seconds=10.0) is None
    assert found_at_s(0.0, 0.1, shift_px=0.0, seconds=10.0) is None, "a motor may not turn at so little"
    assert found_at_s(0.0, 0.0, shift_px=0.0, seconds=10.0) is None


def test_a_look_with_so_much_noise_that_it_cannot_tell_says_nothing() -> None:
    assert found_at_s(0.3, 0.0, shift_px=0.0, sigma_px2=1.0) is None


def came_again_at_s(linear_mps: float, angular_radps: float, **look: float | bool) -> float | None:
    """Return when pictures that flow as they must are found to be those of a while ago; None for never."""
    state = LivenessState()
    for number in range(120):
        at_s = number * CYCLE_S
        command = TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=at_s)
        of_now = flow_since(at_s, 0.13, 0.5)
        again = replace(flow_since(at_s, 1.5, float(look.get("shift_px", 0.0))), is_slid=bool(look.get("is_slid")))
        flow = PictureFlow(textured=0.6, since=(of_now,), again=(again,) if at_s >= 1.5 else ())
        observation = Observation(now_s=at_s, frame=FrameStamp(sequence=number, captured_at_s=at_s), flow=flow)
        state, cause = step_liveness(state, observation, command, is_new=True)
        if cause:
            assert cause.startswith("old pictures have come again: this one is of 1.5 s ago")
            return at_s
    return None


@pytest.mark.parametrize(("linear_mps", "angular_radps"), [(0.1, 0.0), (0.3, 0.0), (0.0, 0.5), (0.2, -0.5)])
def test_a_picture_that_comes_again_elsewhere_is_old_however_well_it_flows(
    linear_mps: float, angular_radps: float
) -> None:
    assert (came_again_at_s(linear_mps, angular_radps) or 9.9) <= 1.7


def test_a_view_that_comes_again_where_the_robot_has_not_moved_on_is_believed() -> None:
    assert came_again_at_s(0.0, 0.0) is None
    assert came_again_at_s(0.0, 0.1) is None, "a motor may not turn at so little"
    assert came_again_at_s(0.3, 0.0, shift_px=1.5) is None, "it is another view"


def test_a_picture_that_is_slid_over_another_shows_a_drive_and_no_turn() -> None:
    assert (came_again_at_s(0.3, 0.0, is_slid=True) or 9.9) <= 1.7
    assert came_again_at_s(0.0, 0.8, is_slid=True) is None


def test_without_a_camera_that_shows_motion_nothing_is_judged() -> None:
    state, cause = LivenessState(), ""
    command = TwistCommand(output="base", linear_mps=0.3, angular_radps=0.0, captured_at_s=0.0)
    for number in range(90):
        stamp = FrameStamp(sequence=number, captured_at_s=number * CYCLE_S)
        state, cause = step_liveness(state, Observation(now_s=number * CYCLE_S, frame=stamp), command, is_new=True)
        assert cause == ""


Place = Callable[[float], tuple[float, float]]


def least_false_alarm(
    linear_mps: float,
    angular_radps: float,
    place: Place | None,
    frozen: tuple[float, float] = (0.0, 3.0),
    seconds: float = 10.0,
) -> float:
    """Return the smallest probability of a false alarm in a drive.

    Args:
        place: Where the target is at a time, on the map of the robot's path; None for a picture that is frozen.
        frozen: The bearing and the distance that a frozen picture shows.
    """
    rng, ego, least = np.random.default_rng(4), EgoMotion(), 1.0
    innovation: TargetInnovation | None = None
    for number in range(round(seconds / CYCLE_S)):
        at_s = number * CYCLE_S
        command = TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=at_s)
        ego = ego.step(at_s, command, None)
        bearing_rad, distance_m = frozen
        if place is not None:
            robot, (x_m, y_m) = ego.path[-1], place(at_s)
            east_m, north_m = x_m - robot.x_m, y_m - robot.y_m
            distance_m = math.hypot(east_m, north_m)
            bearing_rad = robot.heading_rad - math.atan2(north_m, east_m)
            bearing_rad = math.remainder(bearing_rad, math.tau)
        seen = measured("ball", at_s, distance_m + rng.normal(0, 0.01), 0.01, bearing_rad + rng.normal(0, 0.002))
        if abs(bearing_rad) < 1.0:
            innovation = step_innovation(innovation, seen, ego)
        if innovation is not None:
            least = min(least, innovation.false_alarm)
    return least


def test_a_frozen_picture_is_found_where_the_robot_turns_at_it_for_ever() -> None:
    assert least_false_alarm(0.0, 1.0, None, frozen=(0.4, 3.0), seconds=4.0) < FALSE_ALARM
    assert least_false_alarm(0.3, -1.5, None, frozen=(-0.5, 2.0), seconds=4.0) < FALSE_ALARM


def test_driving_straight_on_proves_nothing_since_a_person_may_walk_ahead() -> None:
    assert least_false_alarm(0.3, 0.0, None) > 1e-3


@each_case(
    "place",
    [
        lambda _: (3.0, 0.5),
        lambda at_s: (2.0 + 0.5 * at_s, 0.0),
        lambda at_s: (3.0 + 0.5 * math.sin(2 * at_s), 0.5 * math.cos(at_s)),
        lambda at_s: (3.0, abs(math.sin(4 * at_s))),
    ],
    ids=["stands", "walks ahead", "runs about", "bounces"],
)
@each_case(("linear_mps", "angular_radps"), [(0.3, 0.0), (0.0, 0.5), (0.2, 0.3), (0.0, 1.5)])
def test_a_live_target_is_never_taken_for_a_frozen_one(linear_mps: float, angular_radps: float, place: Place) -> None:
    assert least_false_alarm(linear_mps, angular_radps, place, seconds=30.0) > FALSE_ALARM


def test_a_target_that_walks_a_circle_around_the_robot_is_believed() -> None:
    assert least_false_alarm(0.0, 0.4, lambda at_s: (2 * math.cos(0.4 * at_s), 2 * math.sin(0.4 * at_s))) > FALSE_ALARM


def test_the_probability_of_a_false_alarm_is_that_of_the_chi_square_distribution() -> None:
    still = TargetInnovation(
        at_s=1.0, place_m=(1.0, 0.0), covariance=(1.0, 0.0, 1.0), seen=(0.0, 1.0), innovations=((3.0, 4.0),) * 4
    )
    assert still.false_alarm == pytest.approx(math.exp(-50.0))
    assert replace(still, innovations=((3.0, 4.0),) * 3).false_alarm == 1.0, "too few to tell"
    assert replace(still, innovations=((1.0, 0.0), (-1.0, 0.0)) * 2).false_alarm == 1.0


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
