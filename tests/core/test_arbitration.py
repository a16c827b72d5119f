"""Which request an output follows, and how fast it may change."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.outputs import limit_speed, limit_twist, slew_level
from stadimeter.core.plan import BaseOutput, LevelOutput
from stadimeter.core.rule import LevelRequest, TwistRequest
from stadimeter.core.rules.scheduler import arbitrate

# Which request an output follows when rules of equal priority ask for different things.

RESTRICTIVE = {"base": BaseOutput(name="base", combine="most_restrictive")}
speeds = st.floats(-2, 2)


def twist(rule, linear_mps, angular_radps=0.0, priority=5):
    return TwistRequest(rule=rule, output="base", priority=priority, linear_mps=linear_mps, angular_radps=angular_radps)


def level(rule, value, priority=5):
    return LevelRequest(rule=rule, output="motor", priority=priority, level=value)


def combined(*requests):
    winner = arbitrate(requests, RESTRICTIVE)["base"][0]
    return winner.linear_mps, winner.angular_radps


def test_of_two_equals_that_go_the_same_way_the_slower_speed_counts_for_each_axis():
    assert combined(twist("a", 0.4, 0.1), twist("b", 0.2, 0.9)) == (0.2, 0.1)
    assert combined(twist("a", -0.4, -0.1), twist("b", -0.2, -0.9)) == (-0.2, -0.1)


@pytest.mark.parametrize(("first", "second"), [(0.4, -0.2), (-0.2, 0.4), (0.1, -0.1)])
def test_equals_that_go_opposite_ways_stand_still(first, second):
    """The slower of the two would drive somewhere that one of the rules does not want."""
    assert combined(twist("a", first), twist("b", second)) == (0.0, 0.0)
    assert combined(twist("a", 0.3, first), twist("b", 0.3, second)) == (0.3, 0.0)


@given(st.lists(st.tuples(speeds, speeds), min_size=2, max_size=5))
def test_what_equals_agree_on_is_never_faster_than_any_of_them_nor_another_way(wanted):
    got = combined(*(twist(f"r{number}", *both) for number, both in enumerate(wanted)))
    for axis in (0, 1):
        asked = [both[axis] for both in wanted]
        assert abs(got[axis]) <= min(map(abs, asked))
        assert got[axis] == 0 or all(math.copysign(1, each) == math.copysign(1, got[axis]) for each in asked)
        if min(asked) > 0 or max(asked) < 0:
            assert got[axis] == min(asked, key=abs)


def test_a_base_that_combines_names_every_rule_and_keeps_the_losers_of_lower_priority():
    requests = arbitrate([twist("low", 0.1, priority=1), twist("a", 0.4), twist("b", 0.2)], RESTRICTIVE)["base"]
    assert [(each.rule, each.priority) for each in requests] == [("a+b", 5), ("low", 1)]


def test_a_single_winner_is_not_combined_with_lower_priorities():
    requests = arbitrate([twist("low", -0.1, priority=1), twist("high", 0.4)], RESTRICTIVE)["base"]
    assert [(each.rule, each.linear_mps) for each in requests] == [("high", 0.4), ("low", -0.1)]


@pytest.mark.parametrize(("combine", "rules"), [("max", ["b", "c", "a"]), ("min", ["a", "c", "b"])])
def test_an_actuator_takes_the_highest_or_the_lowest_of_equal_levels(combine, rules):
    outputs = {"motor": LevelOutput(name="motor", combine=combine)}
    requests = [level("a", 0.2), level("b", 0.9), level("c", 0.5), level("low", 1.0, priority=1)]
    assert [each.rule for each in arbitrate(requests, outputs)["motor"]] == [*rules, "low"]


# How fast outputs may change, and who wins them.

levels = st.floats(0, 1)


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
