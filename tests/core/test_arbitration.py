"""Who wins an output, and what equals that combine get."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.plan import BaseOutput, LevelOutput
from stadimeter.core.rule_step import LevelRequest, TwistRequest
from stadimeter.core.rules.arbitration import arbitrate, rearranged

BASE = {"base": BaseOutput(name="base", combine="most_restrictive")}


def twist(rule, linear_mps, angular_radps=0.0, priority=0):
    return TwistRequest(rule=rule, output="base", priority=priority, linear_mps=linear_mps, angular_radps=angular_radps)


def combined(*requests):
    return arbitrate(requests, BASE)["base"][0]


def test_equals_that_go_the_same_way_go_at_the_slower_of_each_speed():
    both = combined(twist("one", 0.4, -0.2), twist("two", 0.1, -0.9))
    assert (both.rule, both.linear_mps, both.angular_radps) == ("one+two", 0.1, -0.2)


@pytest.mark.parametrize(("one", "other"), [(0.4, -0.1), (-0.1, 0.4), (0.1, -0.4)])
def test_equals_that_go_opposite_ways_stand_still(one, other):
    both = combined(twist("one", one, other), twist("two", other, one))
    assert (both.linear_mps, both.angular_radps) == (0.0, 0.0)


def test_of_three_one_that_goes_the_other_way_stops_them_all():
    assert combined(twist("one", 0.4), twist("two", 0.3), twist("three", -0.2)).linear_mps == 0.0


def test_a_higher_priority_is_not_slowed_by_a_lower_one():
    first, second = arbitrate([twist("low", -0.1), twist("high", 0.4, priority=1)], BASE)["base"]
    assert (first.rule, first.linear_mps, second.rule) == ("high", 0.4, "low")


requests = st.lists(
    st.builds(
        lambda number, output, priority, level: (number, output, priority, level),
        st.integers(0, 9),
        st.sampled_from(["motor", "lamp"]),
        st.integers(0, 3),
        st.sampled_from([0.2, 0.8]),
    ),
    max_size=8,
    unique_by=lambda each: each[:2],
)


@given(requests, requests)
def test_rearranging_a_few_requests_gives_what_sorting_all_of_them_gives(before, after):
    def made(pairs):
        return {LevelRequest(rule=f"r{n}", output=o, priority=p, level=v) for n, o, p, v in pairs}

    positions = {f"r{number}": number for number in range(10)}
    was, now = made(before), made(after)

    def in_order(found):
        return sorted(found, key=lambda request: positions[request.rule])

    wanted = rearranged(arbitrate(in_order(was)), was - now, now - was, positions)
    assert wanted == dict(arbitrate(in_order(now)))


@pytest.mark.parametrize(("combine", "first"), [("max", 0.8), ("min", 0.2)])
def test_levels_that_combine_give_the_highest_or_the_lowest(combine, first):
    levels = [LevelRequest(rule=f"r{n}", output="lamp", priority=0, level=level) for n, level in enumerate((0.2, 0.8))]
    assert arbitrate(levels, {"lamp": LevelOutput(name="lamp", combine=combine)})["lamp"][0].level == first
