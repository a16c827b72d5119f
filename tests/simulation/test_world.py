from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.plugins import CAMERAS, WORLDS, DriverContext
from stadimeter.errors import ConfigError
from stadimeter.simulation.world import World, WorldOptions, shared_world
from stadimeter.testing.rig import ManualClock

# As people write them: numbers that are next to nothing, such as 1e-250, are refused.
coordinates = st.floats(-20, 20).map(lambda value: round(value, 3))
headings = st.floats(-4, 4).map(lambda value: round(value, 3))


def still(x: str, y: str) -> list[dict[str, str]]:
    return [{"at": "0 s", "x": x, "y": y}]


def test_a_ball_straight_ahead_is_on_the_optical_axis_but_for_the_heights(make_run) -> None:
    run = make_run(path=still("3 m", "0 m"), ball_diameter="20 cm", camera_height="25 cm")
    assert run.world.target_in_camera() == pytest.approx((0.0, 0.15, 3.0))
    assert run.world.distance_m() == pytest.approx(math.hypot(0.15, 3.0))


def test_what_is_on_the_left_is_negative_to_the_right(make_run) -> None:
    run = make_run(path=still("2 m", "0.5 m"))
    assert run.world.target_in_camera()[0] == pytest.approx(-0.5)


def test_a_turn_to_the_left_moves_the_ball_to_the_right(make_run) -> None:
    run = make_run(path=still("2 m", "0 m"))
    run.world.robot.drive_wheels(-0.1, 0.1)
    run.clock.advance_s(0.3)
    x, _, z = run.world.target_in_camera()
    assert (x, z) == pytest.approx((2 * math.sin(0.3), 2 * math.cos(0.3)))


def test_the_past_is_answered_as_it_was(make_run) -> None:
    run = make_run()
    run.world.robot.drive_wheels(0.2, 0.3)
    run.clock.advance_s(1.0)
    then_s, then = run.world.now_s, run.world.target_in_camera()
    run.clock.advance_s(0.5)
    run.world.robot.drive_wheels(0.0, 0.0)
    run.clock.advance_s(1.0)
    assert run.world.target_in_camera(then_s) == pytest.approx(then)
    assert run.world.target_in_camera() != pytest.approx(then)


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


def test_a_simulated_camera_without_a_lens_says_what_to_add(make_run) -> None:
    with pytest.raises(ConfigError, match=r"'eye' is simulated and needs a lens.*set model in \[camera\]"):
        make_run(lens=None).build(CAMERAS, name="eye")
