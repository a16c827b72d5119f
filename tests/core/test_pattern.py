"""Levels that change by themselves."""

import math

from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.rule import Pattern
from support.each_case import each_case

THREE_BURSTS = Pattern(steps=((1.0, 0.2), (0.0, 0.3)), times=3)

steps = st.lists(st.tuples(st.floats(0, 1), st.floats(0.05, 60)), min_size=1, max_size=8).map(tuple)
times_s = st.floats(0, 1e5)


@each_case(
    ("since_s", "level"),
    [(0.0, 1.0), (0.199, 1.0), (0.2, 0.0), (0.499, 0.0), (0.5, 1.0), (1.199, 1.0), (1.2, 0.0), (1.5, 0.0), (99.0, 0.0)],
)
def test_a_pattern_is_gone_through_as_often_as_it_says_and_then_is_off(since_s, level):
    assert THREE_BURSTS.level(since_s) == level


def test_sums_of_frame_times_do_not_shift_a_step():
    since_s = 0.0
    levels = []
    for _ in range(15):
        levels.append(THREE_BURSTS.level(since_s))
        since_s += 0.1
    assert levels == [1, 1, 0, 0, 0] * 3


@given(steps, times_s, st.integers(0, 5))
def test_a_level_is_always_one_of_the_steps_or_off(levels, since_s, times):
    found = Pattern(steps=levels, times=times).level(since_s)
    assert found in {0.0, *(level for level, _ in levels)}


@given(steps, times_s)
def test_a_pattern_without_an_end_goes_on_for_ever(levels, since_s):
    assert Pattern(steps=levels).level(since_s) in {level for level, _ in levels}


@given(steps, st.integers(1, 5))
def test_after_its_last_turn_a_pattern_is_off(levels, times):
    whole_s = math.fsum(for_s for _, for_s in levels) * times
    assert Pattern(steps=levels, times=times).level(whole_s + 0.001) == 0.0


def test_a_time_before_the_beginning_counts_as_the_beginning():
    assert THREE_BURSTS.level(-1.0) == 1.0
