"""No stall that drains a tenth faster than pictures are captured drives a robot, and live links stop none."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st


@pytest.mark.long
@pytest.mark.parametrize("has_begun", [False, None])
@given(drain=st.floats(1.1, 20.0), seed=st.integers(0, 2**32), jitter=st.floats(0.0, 0.2))
def test_no_stall_that_drains_a_tenth_too_fast_is_driven_on(
    has_begun: bool | None, drain: float, seed: int, jitter: float
) -> None:
    from stream_ages import DROVE_S, drove_on_old_s, stalled

    assert drove_on_old_s(stalled(drain, seed, jitter=jitter), has_begun) <= DROVE_S


def test_the_benchmark_counts_stalls_that_are_driven_on() -> None:
    from stream_ages import DROVE_S, drove_on_old_s, stalled

    assert max(drove_on_old_s(stalled(1.02, seed), False) for seed in range(8)) > DROVE_S


@pytest.mark.parametrize("has_begun", [False, None])
def test_gaussian_jitter_stops_no_robot(has_begun: bool | None) -> None:
    from stream_ages import LIVE, stops

    assert stops(LIVE["Gaussian jitter, 10 ms"](1, 0.1), has_begun) == (0, 0, 0.0)


def test_a_stop_counts_once_and_for_as_long_as_it_lasts() -> None:
    from stream_ages import MAX_AGE_S, RATE_HZ, WAY_S, stops

    numbers = itertools.chain(range(1500), range(1530, 3000))  # a second of pictures is lost
    by_age, ours, share = stops(((number / RATE_HZ, number / RATE_HZ + WAY_S) for number in numbers), has_begun=False)
    assert (by_age, ours) == (1, 1)
    assert 1.0 - MAX_AGE_S < 80 * share < 3.0
