from __future__ import annotations

import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from stadimeter.config.plugins import BASES
from stadimeter.core.command import TwistCommand
from stadimeter.errors import DeviceOpenError, LinkLostError
from stadimeter.simulation.base import SimulatedBaseOptions


def twist(linear_mps: float, angular_radps: float = 0.0) -> TwistCommand:
    return TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=1.0)


def opened(run, **options):
    base = run.build(BASES, **options)
    base.open()
    return base


def test_it_drives_the_worlds_robot(run) -> None:
    opened(run).apply(twist(0.2, 0.5))
    run.clock.advance_s(1.0)
    pose = run.world.robot.pose
    assert (pose.x_m, pose.y_m, pose.heading_rad) == pytest.approx(
        (0.4 * math.sin(0.5), 0.4 * (1 - math.cos(0.5)), 0.5)
    )


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(linear=st.floats(-5, 5), angular=st.floats(-50, 50))
def test_no_wheel_runs_too_fast_and_the_curve_stays(make_run, linear: float, angular: float) -> None:
    run = make_run(track_width="20 cm")
    applied = opened(run, max_wheel_speed="0.5 m/s").apply(twist(linear, angular))
    wheels = run.world.robot.wheels_mps
    assert max(map(abs, wheels)) <= 0.5 + 1e-12
    assert wheels == pytest.approx(
        (applied.linear_mps - applied.angular_radps * 0.1, applied.linear_mps + applied.angular_radps * 0.1)
    )
    assert applied.linear_mps * angular == pytest.approx(linear * applied.angular_radps, abs=1e-9)
    if max(abs(linear - angular * 0.1), abs(linear + angular * 0.1)) <= 0.5:
        assert (applied.linear_mps, applied.angular_radps) == (linear, angular)


def test_it_stops_by_itself_when_nothing_comes(run) -> None:
    opened(run, auto_stop="500 ms").apply(twist(0.2))
    run.clock.advance_s(10.0)
    assert run.world.robot.pose.x_m == pytest.approx(0.1)
    assert run.world.robot.wheels_mps == (0.0, 0.0)


def test_it_need_not_stop_by_itself(run) -> None:
    opened(run, auto_stop="0 s").apply(twist(0.2))
    run.clock.advance_s(10.0)
    assert run.world.robot.pose.x_m == pytest.approx(2.0)


def test_unplugged_it_says_so_and_the_robot_rolls_on_until_it_stops_by_itself(run) -> None:
    base = opened(run, auto_stop="1 s")
    base.apply(twist(0.2))
    run.world.faults.base_unplugged = True
    for use in (lambda: base.apply(twist(0.2)), lambda: base.tick(100.0), base.stop):
        with pytest.raises(LinkLostError, match="unplugged"):
            use()
    assert run.world.robot.wheels_mps == (0.2, 0.2)
    run.clock.advance_s(2.0)
    assert run.world.robot.pose.x_m == pytest.approx(0.2)


def test_a_lost_link_needs_opening_again_even_when_plugged_in_again(run) -> None:
    base = opened(run)
    run.world.faults.base_unplugged = True
    with pytest.raises(LinkLostError):
        base.tick(100.0)
    run.world.faults.base_unplugged = False
    with pytest.raises(LinkLostError):
        base.apply(twist(0.2))
    assert run.world.robot.wheels_mps == (0.0, 0.0)
    with pytest.raises(LinkLostError):
        base.close()
    base.open()
    assert base.apply(twist(0.2)).linear_mps == 0.2


def test_unplugged_it_cannot_be_opened(run) -> None:
    run.world.faults.base_unplugged = True
    base = run.build(BASES)
    with pytest.raises(DeviceOpenError, match="unplugged"):
        base.open()
    base.close()


@pytest.mark.parametrize("options", [{"max_wheel_speed": "0 m/s"}, {"auto_stop": "-1 s"}, {"port": "/dev/ttyUSB0"}])
def test_a_wrong_option_is_refused(options) -> None:
    with pytest.raises(ValidationError):
        SimulatedBaseOptions.model_validate(options)
