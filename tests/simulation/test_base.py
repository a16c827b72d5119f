from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from stadimeter.config.plugins import BASES
from stadimeter.core.command import TwistCommand
from stadimeter.simulation.base import SimulatedBaseOptions


def twist(linear_mps: float, angular_radps: float = 0.0) -> TwistCommand:
    return TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=1.0)


def opened(run, **options):
    base = run.build(BASES, **options)
    base.open()
    return base


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


@pytest.mark.parametrize("options", [{"max_wheel_speed": "0 m/s"}, {"auto_stop": "-1 s"}, {"port": "/dev/ttyUSB0"}])
def test_a_wrong_option_is_refused(options) -> None:
    with pytest.raises(ValidationError):
        SimulatedBaseOptions.model_validate(options)
