"""The simulated world: robot, ball, faults, noise and options."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import fields
from pydantic import ValidationError

from stadimeter.config.plugins import WORLDS, DriverContext
from stadimeter.errors import ConfigError
from stadimeter.simulation.motion import Ball, DifferentialRobot, Pose, WayPoint
from stadimeter.simulation.world import (
    BY_HAND_S,
    KNOBS,
    FaultKind,
    Faults,
    FaultSchedule,
    ScheduledFault,
    World,
    WorldOptions,
    shared_world,
)
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case

# As people write them: numbers that are next to nothing, such as 1e-250, are refused.
coordinates = st.floats(-20, 20).map(lambda value: round(value, 3))
headings = st.floats(-4, 4).map(lambda value: round(value, 3))


def still(x: str, y: str) -> list[dict[str, str]]:
    return [{"at": "0 s", "x": x, "y": y}]


def test_a_ball_straight_ahead_is_on_the_optical_axis_but_for_the_heights(make_run) -> None:
    run = make_run(path=still("3 m", "0 m"), ball_diameter="20 cm", camera_height="25 cm")
    assert run.world.target_in_camera() == pytest.approx((0.0, 0.15, 3.0))
    assert run.world.distance_m() == pytest.approx(math.hypot(0.15, 3.0))


def test_a_turn_to_the_left_moves_the_ball_to_the_right(make_run) -> None:
    run = make_run(path=still("2 m", "0 m"))
    run.world.robot.drive_wheels(-0.1, 0.1)
    run.clock.advance_s(0.3)
    x, _, z = run.world.target_in_camera()
    assert (x, z) == pytest.approx((2 * math.sin(0.3), 2 * math.cos(0.3)))


@given(x=coordinates, y=coordinates, robot_x=coordinates, robot_y=coordinates, heading=headings)
def test_turning_and_moving_everything_changes_no_distance(
    x: float, y: float, robot_x: float, robot_y: float, heading: float
) -> None:
    options = {
        "path": [{"at": "0 s", "x": f"{x} m", "y": f"{y} m"}],
        "robot_x": f"{robot_x} m",
        "robot_y": f"{robot_y} m",
        "robot_heading": f"{heading} rad",
    }
    world = World(WorldOptions.model_validate(options), ManualClock())
    assert world.distance_m() == pytest.approx(math.hypot(x - robot_x, y - robot_y, 0.15))


def test_the_schedule_counts_from_the_start_of_the_run(make_run) -> None:
    run = make_run(faults=[{"at": "12 s", "for": "2 s", "kind": "hide-target"}])
    seen = []
    for _ in range(16):
        seen.append(run.world.faults.target_hidden)
        run.clock.advance_s(1.0)
    assert [second for second, hidden in enumerate(seen) if hidden] == [12, 13]


def test_the_path_counts_from_the_start_of_the_run(make_run) -> None:
    path = [{"at": "0 s", "x": "2 m", "y": "0 m"}, {"at": "10 s", "x": "5 m", "y": "0 m"}]
    run = make_run(path=path, loop=False)
    assert run.world.target_in_camera()[2] == pytest.approx(2.0)
    run.clock.advance_s(10.0)
    assert run.world.target_in_camera()[2] == pytest.approx(5.0)


def test_the_drivers_of_a_run_share_one_world(make_run) -> None:
    run = make_run()
    assert run.build(WORLDS) is run.world
    assert shared_world(run.context("anything")) is run.world


def test_a_simulated_driver_without_a_world_says_what_to_add() -> None:
    context = DriverContext(name="eye", clock=ManualClock())
    with pytest.raises(ConfigError, match=r"'eye' is simulated and needs a world.*add a table \[world\]"):
        shared_world(context)


TRACK_M = 0.2
speeds = st.floats(-1.0, 1.0)
times = st.floats(0.01, 10.0)


def robot_at(x_m: float = 0.0, y_m: float = 0.0, heading_rad: float = 0.0) -> tuple[DifferentialRobot, ManualClock]:
    clock = ManualClock(50.0)
    start = Pose(x_m=x_m, y_m=y_m, heading_rad=heading_rad)
    return DifferentialRobot(track_width_m=TRACK_M, ticks_per_metre=1000.0, start=start, clock=clock), clock


def figures(pose: Pose) -> tuple[float, float, float]:
    return pose.x_m, pose.y_m, pose.heading_rad


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


metres = st.floats(-10, 10).map(lambda value: round(value, 3))


def point(at_s: float, x_m: float, y_m: float = 0.0) -> WayPoint:
    return WayPoint.model_validate({"at": f"{at_s} s", "x": f"{x_m} m", "y": f"{y_m} m"})


def ball_on(*path: WayPoint, loop: bool = False, start_s: float = 0.0) -> Ball:
    return Ball(diameter_m=0.2, height_m=0.1, path=path, loop=loop, start_s=start_s)


def test_a_ball_is_at_its_way_points_in_time() -> None:
    ball = ball_on(point(0, 2), point(3, 5, 1), point(4, 1, -2), start_s=100.0)
    assert ball.position_m(100.0) == pytest.approx((2, 0, 0.1))
    assert ball.position_m(103.0) == pytest.approx((5, 1, 0.1))
    assert ball.position_m(104.0) == pytest.approx((1, -2, 0.1))


def test_the_speed_never_jumps() -> None:
    ball = ball_on(point(0, 1), point(2, 3), point(3, 3.5), point(6, 9), point(9, 1), loop=True)
    step_s = 1e-3
    xs = [ball.position_m(number * step_s)[0] for number in range(18000)]
    speeds = [(after - before) / step_s for before, after in pairwise(xs)]
    changes = [abs(after - before) for before, after in pairwise(speeds)]
    assert max(changes) < 20 * step_s


@given(
    xs=st.lists(metres, min_size=2, max_size=6),
    gaps=st.lists(st.integers(1, 50), min_size=6, max_size=6),
    share=st.floats(0, 1),
    loop=st.booleans(),
)
def test_a_ball_stays_between_its_way_points(xs: list[float], gaps: list[int], share: float, loop: bool) -> None:
    xs = [*xs, xs[0]] if loop else xs
    times_s = [sum(gaps[:index]) / 10 for index in range(len(xs))]
    ball = ball_on(*(point(time_s, x_m) for time_s, x_m in zip(times_s, xs, strict=True)), loop=loop)
    at_s = share * times_s[-1]
    leg = next(index for index in range(len(xs) - 1) if at_s <= times_s[index + 1])
    low, high = sorted(xs[leg : leg + 2])
    assert low - 1e-9 <= ball.position_m(at_s)[0] <= high + 1e-9


def fault(kind: str, at: str, lasts: str | None = None) -> ScheduledFault:
    return ScheduledFault.model_validate({"kind": kind, "at": at, "for": lasts} if lasts else {"kind": kind, "at": at})


def test_every_kind_of_fault_has_its_own_knob() -> None:
    assert set(KNOBS) == set(FaultKind)
    assert sorted(KNOBS.values()) == sorted(field.name for field in fields(Faults))


@each_case("kind", list(FaultKind))
def test_a_scheduled_fault_begins_and_ends_in_time(kind: FaultKind) -> None:
    faults, schedule = Faults(), FaultSchedule([fault(kind, "12 s", "2 s")], start_s=100.0)
    states = {}
    for now_s in (111.9, 112.0, 113.9, 114.0):
        schedule.turn(faults, now_s)
        states[now_s] = getattr(faults, KNOBS[kind])
        assert sum(getattr(faults, knob) for knob in KNOBS.values()) == states[now_s], "another knob was turned"
    assert states == {111.9: False, 112.0: True, 113.9: True, 114.0: False}


def test_a_knob_turned_by_hand_stays_until_its_next_scheduled_time() -> None:
    faults, schedule = Faults(), FaultSchedule([fault("hide-target", "5 s", "1 s")], start_s=0.0)
    faults.target_hidden = True
    schedule.turn(faults, 4.0)
    assert faults.target_hidden
    schedule.turn(faults, 6.0)
    assert not faults.target_hidden


def test_a_fault_made_by_hand_ends_by_itself_and_one_that_was_made_again_has_its_whole_time(make_run) -> None:
    run = make_run()

    def is_frozen_after(wait_s: float) -> bool:
        run.clock.advance_s(wait_s)
        return run.world.goes_wrong("freeze-camera")

    for _ in range(3):
        run.world.toggle("freeze-camera")
    assert is_frozen_after(BY_HAND_S - 0.1)
    assert not is_frozen_after(0.2)
    run.world.toggle("freeze-camera")
    run.clock.advance_s(3.0)
    run.world.toggle("freeze-camera")
    run.world.toggle("freeze-camera")
    assert is_frozen_after(BY_HAND_S - 0.1)
    assert not is_frozen_after(0.2)


def test_the_schedule_goes_before_the_end_of_a_fault_made_by_hand(make_run) -> None:
    run = make_run(faults=[{"at": "8 s", "for": "6 s", "kind": "hide-target"}])
    run.world.toggle("hide-target")
    run.clock.advance_s(13.0)
    assert run.world.goes_wrong("hide-target")
    run.clock.advance_s(1.5)
    assert not run.world.goes_wrong("hide-target")


def read(**options: Any) -> WorldOptions:
    return WorldOptions.model_validate(options)


def test_options_are_read_with_their_units() -> None:
    options = read(
        ball_diameter="8 in",
        robot_x="-50 cm",
        robot_heading="90 deg",
        path=[{"at": "0 s", "x": "-2 m", "y": "3 ft"}],
        faults=[{"at": "1 min", "for": "500 ms", "kind": "freeze-camera"}],
    )
    assert options.ball_diameter == pytest.approx(0.2032)
    assert options.robot_x == -0.5
    assert options.robot_heading == pytest.approx(1.5707963)
    assert (options.path[0].x, options.path[0].y) == pytest.approx((-2.0, 0.9144))
    fault = options.faults[0]
    assert (fault.at, fault.duration, fault.kind) == (60.0, 0.5, FaultKind.FREEZE_CAMERA)


@each_case(
    ("options", "words"),
    [
        ({"path": []}, "at least 1 item"),
        ({"path": [{"at": "1 s", "x": "1 m", "y": "0 m"}]}, "first way point must be at '0 s'"),
        (
            {"loop": False, "path": [{"at": at, "x": "1 m", "y": "0 m"} for at in ("0 s", "2 s", "2 s")]},
            "order them by time",
        ),
        (
            {"path": [{"at": "0 s", "x": "1 m", "y": "0 m"}, {"at": "2 s", "x": "2 m", "y": "0 m"}]},
            "end it where it begins, or set loop = false",
        ),
        ({"robot_x": "3"}, "has no unit"),
        ({"robot_x": 3}, "has no unit"),
        ({"robot_y": "1 parsec"}, "unknown unit 'parsec'"),
        ({"ball_diameter": "0 cm"}, "not a length above zero"),
        ({"ball_height": "-1 cm"}, "below zero"),
        ({"track_width": "-20 cm"}, "not a length above zero"),
        ({"ticks_per_metre": 0}, "greater than 0"),
        ({"seed": -1}, "greater than or equal to 0"),
        ({"faults": [{"at": "1 s", "kind": "flat-tyre"}]}, "'hide-target', 'freeze-camera'"),
        ({"faults": [{"at": "1 s", "duration": "1 s", "kind": "hide-target"}]}, "Extra inputs"),
        ({"balls": 2}, "Extra inputs"),
    ],
)
def test_a_wrong_option_is_refused_in_words(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError) as raised:
        read(**options)
    assert words in str(raised.value)
