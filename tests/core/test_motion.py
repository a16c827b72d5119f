"""Three filters side by side."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.tracking import motion

distances = st.floats(0.1, 20)
noises = st.floats(1e-3, 0.5)

FRAME_S = 1 / 15
NOISE_M, CORRELATION, ACCELERATION_MPS2 = 0.024, 0.6, 2.0


def follow(distances_m, seed=3):
    """Return the state after each measurement of these distances, with noise."""
    chance = np.random.default_rng(seed)
    states, noise = [], chance.normal()
    for distance_m in distances_m:
        noise = CORRELATION * noise + math.sqrt(1 - CORRELATION**2) * chance.normal()
        measured_m = distance_m + NOISE_M * noise
        if not states:
            states.append(motion.start(measured_m, NOISE_M))
            continue
        expected = motion.predict(states[-1], FRAME_S, ACCELERATION_MPS2, CORRELATION)
        states.append(motion.update(expected, NOISE_M, motion.compare(expected, measured_m, NOISE_M)))
    return states


def way(*speeds_mps, frames=60, start_m=4.0):
    """Return distances, so many frames at each speed of approach."""
    distances_m = [start_m]
    for speed_mps in speeds_mps:
        distances_m += [distances_m[-1] - speed_mps * FRAME_S * (frame + 1) for frame in range(frames)]
    return distances_m


def test_a_target_at_rest_and_one_at_a_steady_speed_are_taken_for_calm():
    assert follow(way(0.0))[-1].constant_share > 0.9
    assert follow(way(0.6))[-1].constant_share > 0.9


def test_a_target_that_starts_at_once_is_followed_within_three_frames():
    distances_m = way(0.0, 2.0, frames=20)
    states = follow(distances_m)
    starts = 21
    assert min(state.constant_share for state in states[starts : starts + 3]) < 0.1
    for state, distance_m in zip(states[starts + 2 :], distances_m[starts + 2 :], strict=True):
        together = state.estimate()
        assert abs(together.distance_m - distance_m) < 4 * math.sqrt(together.var_distance_m2)


@pytest.mark.parametrize("speed_mps", [0.0, 0.5])
def test_it_states_its_true_error(speed_mps):
    innovations = []
    for seed in range(200):
        distances_m = way(speed_mps, frames=45)
        together = follow(distances_m, seed)[-1].estimate()
        innovations.append(abs(together.distance_m - distances_m[-1]) / math.sqrt(together.var_distance_m2))
    inside = sum(innovation < 1.645 for innovation in innovations) / len(innovations)
    assert 0.85 <= inside <= 0.97  # of a 90 % interval


@given(distances, noises, st.floats(0, 0.95), st.lists(st.tuples(distances, noises, st.floats(0, 100)), max_size=20))
def test_whatever_is_measured_the_figures_stay_finite_and_all_filters_possible(distance, noise, correlation, seen):
    state = motion.start(distance, noise)
    for measured, sigma, step in seen:
        state = motion.predict(state, step, 2.0, correlation)
        assert math.isfinite(motion.compare(state, measured, sigma).sigmas)
        assert 0 < state.constant_share < 1
        state = motion.update(state, sigma, motion.compare(state, measured, sigma))
        together = state.estimate()
        assert all(map(math.isfinite, together))
        assert together.var_distance_m2 > 0
        assert together.cov_m2ps**2 <= together.var_distance_m2 * together.var_rate_m2ps2 * (1 + 1e-6) + 1e-12


def test_after_a_long_time_a_target_is_as_calm_as_targets_usually_are():
    for shares in ((0.01, 0.01, 0.98), (0.98, 0.01, 0.01)):
        state = motion.start(2.0, 0.01)._replace(
            constant_share=shares[0], swaying_share=shares[1], manoeuvring_share=shares[2]
        )
        later = motion.predict(state, 1000.0, 2.0, 0.6)
        assert (later.constant_share, later.swaying_share, later.manoeuvring_share) == pytest.approx(motion.USUAL)


def sway(amplitude_m, hz, frames=20_000, at_m=4.0):
    """Return the distances of a target that sways."""
    return [at_m + amplitude_m * math.sin(2 * math.pi * hz * FRAME_S * frame) for frame in range(frames)]


def errors_of(distances_m, settle=50):
    """Return the errors in metres, and in stated standard deviations, once the filters have settled."""
    estimates = [state.estimate() for state in follow(distances_m)]
    errors_m = np.array([each.distance_m for each in estimates])[settle:] - distances_m[settle:]
    return errors_m, errors_m / np.sqrt([each.var_distance_m2 for each in estimates][settle:])


def test_a_target_that_sways_is_followed_with_an_error_as_stated():
    _, sigmas = errors_of(sway(0.4, 0.25))
    assert 0.63 <= np.mean(np.abs(sigmas) < 1) <= 0.74
    assert 0.86 <= np.mean(np.abs(sigmas) < 1.645) <= 0.94


def test_single_errors_far_from_the_rest_hardly_pull_a_target_at_rest(monkeypatch):
    def pulled_m():
        state = motion.start(4.0, NOISE_M)
        for _ in range(60):
            state = motion.predict(state, FRAME_S, ACCELERATION_MPS2, CORRELATION)
            state = motion.update(state, NOISE_M, motion.compare(state, 4.0, NOISE_M))
        state = motion.predict(state, FRAME_S, ACCELERATION_MPS2, CORRELATION)
        state = motion.update(state, NOISE_M, motion.compare(state, 4.0 - 4 * NOISE_M, NOISE_M))
        return 4.0 - state.constant.distance_m

    trusted_m = pulled_m()
    monkeypatch.setattr(motion, "TRUSTED_SQUARE", math.inf)
    assert 0 < trusted_m < 0.8 * pulled_m()
