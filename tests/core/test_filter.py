"""The filter on distance."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.tracking import filter as kalman

distances = st.floats(0.1, 20)
noises = st.floats(1e-3, 0.5)


@given(distances, noises, st.floats(0, 2), st.floats(0, 2), st.floats(0.1, 5))
def test_two_short_predictions_are_one_long_one(distance, noise, first, second, acceleration):
    start = kalman.update(kalman.start(distance, noise**2), distance, noise**2)
    once = kalman.predict(start, first + second, acceleration)
    twice = kalman.predict(kalman.predict(start, first, acceleration), second, acceleration)
    assert twice.distance_m == pytest.approx(once.distance_m)
    assert twice.var_distance_m2 == pytest.approx(once.var_distance_m2)
    assert twice.cov_m2ps == pytest.approx(once.cov_m2ps)
    assert twice.var_rate_m2ps2 == pytest.approx(once.var_rate_m2ps2)


@given(distances, noises, st.lists(st.tuples(distances, noises, st.floats(0.01, 1)), max_size=30))
def test_the_covariance_stays_one_that_can_exist(distance, noise, measurements):
    state = kalman.start(distance, noise**2)
    for measured, sigma, step in measurements:
        state = kalman.predict(state, step, 2.0)
        before = state.var_distance_m2
        state = kalman.update(state, measured, sigma**2)
        assert 0 < state.var_distance_m2 <= before
        assert state.var_distance_m2 <= sigma**2
        assert state.cov_m2ps**2 <= state.var_distance_m2 * state.var_rate_m2ps2 * (1 + 1e-6) + 1e-12
        assert state.distance_m >= 0


def test_a_steady_approach_is_learnt_without_lag():
    state, truth = kalman.start(4.0, 0.01**2), 4.0
    for _ in range(60):
        truth -= 0.5 / 30
        state = kalman.update(kalman.predict(state, 1 / 30, 1.0), truth, 0.01**2)
    assert state.rate_mps == pytest.approx(-0.5, abs=0.01)
    assert state.distance_m == pytest.approx(truth, abs=0.002)


def test_a_distance_that_would_become_negative_stays_at_zero():
    state = kalman.FilterState(distance_m=0.2, rate_mps=-5, var_distance_m2=0.01, cov_m2ps=0, var_rate_m2ps2=0.01)
    assert kalman.predict(state, 1.0, 1.0).distance_m == 0.0


def test_noise_that_lasts_from_frame_to_frame_counts_for_more():
    assert kalman.variance_of(0.1, 0.6) == pytest.approx(4 * 0.01)
    assert kalman.variance_of(0.1, 0.0) == pytest.approx(0.01)


def test_a_claim_of_no_noise_at_all_is_not_believed():
    assert kalman.variance_of(0.0, 0.0) == kalman.NOISE_FLOOR_M**2
    assert math.isfinite(kalman.surprise_sigmas(kalman.start(1.0, 1e-8), 2.0, kalman.variance_of(0.0, 0.0)))
