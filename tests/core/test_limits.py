"""How fast outputs may change, and who wins them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.outputs import limit_speed, limit_twist, slew_level
from stadimeter.core.plan import BaseOutput, LevelOutput
from stadimeter.core.rule import LevelRequest
from stadimeter.core.rules.scheduler import arbitrate

levels = st.floats(0, 1)
speeds = st.floats(-2, 2)


@given(levels, levels, st.floats(0.01, 10), st.floats(0.01, 10), st.floats(0, 1))
def test_a_level_never_changes_faster_than_its_limits_nor_overshoots(before, wanted, rise, fall, step):
    output = LevelOutput(name="motor", rise_per_s=rise, fall_per_s=fall)
    level = slew_level(output, before, wanted, step)
    assert -fall * step - 1e-12 <= level - before <= rise * step + 1e-12
    assert min(before, wanted) <= level <= max(before, wanted)


def test_without_limits_a_level_jumps_even_in_the_first_cycle():
    assert slew_level(LevelOutput(name="motor"), 0.0, 0.7, 0.0) == 0.7


@given(speeds, speeds, st.floats(0, 1))
def test_a_base_slows_down_at_once_and_speeds_up_gently(before, wanted, step):
    speed = limit_speed(before, wanted, 1.0, 0.5, step)
    assert abs(speed) <= 1.0
    assert abs(speed) <= abs(before) + 0.5 * step + 1e-12 or abs(before) > 1.0
    if abs(wanted) <= abs(before) and (wanted > 0) is (before > 0) and abs(wanted) <= 1:
        assert speed == wanted


def test_a_base_that_shall_reverse_passes_through_zero():
    assert limit_speed(0.4, -0.4, 1.0, 0.5, 0.1) == pytest.approx(-0.05)


def test_stopping_is_immediate():
    assert limit_twist(BaseOutput(name="base"), (0.5, 1.0), (0.0, 0.0), 0.001) == (0.0, 0.0)


def test_the_highest_priority_wins_and_the_first_of_equals():
    requests = [
        LevelRequest(rule=name, output=output, priority=priority, level=0.5)
        for name, output, priority in [("a", "x", 1), ("b", "x", 9), ("c", "x", 9), ("d", "y", 1)]
    ]
    sorted_out = arbitrate(requests)
    assert [request.rule for request in sorted_out["x"]] == ["b", "c", "a"]
    assert [request.rule for request in sorted_out["y"]] == ["d"]
    assert not math.isnan(sorted_out["x"][0].level)
