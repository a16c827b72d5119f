"""The filter on distance."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.tracking import filter as kalman

distances = st.floats(0.1, 20)
noises = st.floats(1e-3, 0.5)
correlations = st.floats(0, 0.95)


def seen(state, distance_m, noise_m):
    """Return what the filter knows after a measurement."""
    return kalman.update(state, noise_m, *kalman.innovation(state, distance_m, noise_m))


@given(distances, noises, st.floats(0, 2), st.floats(0, 2), st.floats(0.1, 5))
def test_two_short_predictions_are_one_long_one(distance, noise, first, second, acceleration):
    start = seen(kalman.start(distance, noise), distance, noise)
    once = kalman.predict(start, first + second, acceleration, 0.6)
    twice = kalman.predict(kalman.predict(start, first, acceleration, 0.6), second, acceleration, 0.6)
    assert twice.distance_m == pytest.approx(once.distance_m)
    assert twice.var_distance_m2 == pytest.approx(once.var_distance_m2)
    assert twice.cov_m2ps == pytest.approx(once.cov_m2ps)
    assert twice.var_rate_m2ps2 == pytest.approx(once.var_rate_m2ps2)


@given(distances, noises, correlations, st.lists(st.tuples(distances, noises, st.floats(0.01, 1)), max_size=30))
def test_the_covariance_stays_one_that_can_exist(distance, noise, correlation, measurements):
    state = kalman.start(distance, noise)
    for measured, sigma, step in measurements:
        state = kalman.predict(state, step, 2.0, correlation)
        before = state
        state = seen(state, measured, sigma)
        assert 0 < state.var_distance_m2 <= before.var_distance_m2 * (1 + 1e-9)
        assert state.var_distance_m2 <= sigma**2 * (1 + 1e-6)
        assert 0 <= state.var_noise <= before.var_noise <= 1 + 1e-9
        assert state.cov_m2ps**2 <= state.var_distance_m2 * state.var_rate_m2ps2 * (1 + 1e-6) + 1e-12
        assert state.cov_noise_m**2 <= state.var_distance_m2 * state.var_noise * (1 + 1e-6) + 1e-12
        assert state.cov_rate_noise_mps**2 <= state.var_rate_m2ps2 * state.var_noise * (1 + 1e-6) + 1e-12
        assert state.distance_m >= 0


def test_a_steady_approach_is_learnt_without_lag():
    state, truth = kalman.start(4.0, 0.01), 4.0
    for _ in range(60):
        truth -= 0.5 / 30
        state = seen(kalman.predict(state, 1 / 30, 1.0, 0.6), truth, 0.01)
    assert state.rate_mps == pytest.approx(-0.5, abs=0.01)
    assert state.distance_m == pytest.approx(truth, abs=0.002)


def test_a_distance_that_would_become_negative_stays_at_zero():
    state = kalman.start(0.2, 0.1)._replace(rate_mps=-5.0)
    assert kalman.predict(state, 1.0, 1.0, 0.6).distance_m == 0.0


def still(correlation, believed, frames=40_000, noise_m=0.1):
    """Return the true standard deviation of the error, and the stated one, for a target that stands still."""
    chance = np.random.default_rng(7)
    kept = math.sqrt(1 - kalman.FRESH_SHARE)
    state, noise, errors = None, chance.normal(), []
    for _ in range(frames):
        noise = correlation * noise + math.sqrt(1 - correlation**2) * chance.normal()
        measured = 2.0 + noise_m * (kept * noise + math.sqrt(kalman.FRESH_SHARE) * chance.normal())
        state = (
            kalman.start(measured, noise_m)
            if state is None
            else seen(kalman.predict(state, 1 / 15, 0.1, believed), measured, noise_m)
        )
        errors.append(state.distance_m - 2.0)
    return math.sqrt(sum(error**2 for error in errors) / len(errors)), math.sqrt(state.var_distance_m2)


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.6, 0.9])
def test_it_states_its_true_error_for_noise_that_lasts_from_frame_to_frame(correlation):
    true_m, stated_m = still(correlation, correlation)
    # The target stands still, and the filter allows for a little more.
    assert 0.8 * stated_m <= true_m <= 1.05 * stated_m


@given(distances, distances, noises, noises, st.floats(0, 1))
def test_of_two_states_that_differ_the_mixture_is_less_sure_than_their_mean(first, second, sigma, other_sigma, share):
    one, other = kalman.start(first, sigma), kalman.start(second, other_sigma)
    mixture = kalman.mix(one, other, share)
    low, high = min(first, second), max(first, second)
    assert low - 1e-9 <= mixture.distance_m <= high + 1e-9
    mean = share * one.var_distance_m2 + (1 - share) * other.var_distance_m2
    assert mixture.var_distance_m2 >= mean * (1 - 1e-12)
