from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.command import TwistCommand
from stadimeter.core.liveness import FALSE_ALARM, EgoMotion, TargetInnovation, step_innovation
from support.each_case import each_case
from support.observing import measured

CYCLE_S = 1 / 30

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
