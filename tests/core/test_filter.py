"""The filter on distance: motion, and what is learnt of a target's noise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.measurement import TrackStatus
from stadimeter.core.plan import Tracking
from stadimeter.core.tracking import filter as kalman
from stadimeter.core.tracking import motion
from stadimeter.core.tracking.life_cycle import new_track, step
from stadimeter.core.tracking.motion import LineDeviation, NoiseEstimate
from support.observing import measured

# The filter on distance.

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
    for far_m, sigma, step_s in measurements:
        state = kalman.predict(state, step_s, 2.0, correlation)
        before = state
        state = seen(state, far_m, sigma)
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


# Three filters side by side.

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
    for far_m, sigma, step_s in seen:
        state = motion.predict(state, step_s, 2.0, correlation)
        assert math.isfinite(motion.compare(state, far_m, sigma).sigmas)
        assert 0 < state.constant_share < 1
        state = motion.update(state, sigma, motion.compare(state, far_m, sigma))
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


# What is learnt of a target's noise.

STATED_M = 0.008
SETTINGS = Tracking()


def noise_of(times, correlation, frames, seed):
    """Return noise that is this many times as large as stated, and lasts from frame to frame."""
    fresh, last, noise_m = np.random.default_rng(seed).normal(size=frames), 0.0, []
    for each in fresh:
        last = correlation * last + math.sqrt(1 - correlation**2) * each
        noise_m.append(times * STATED_M * last)
    return noise_m


def tracks_of(distances_m, settings=SETTINGS, sigma_m=STATED_M):
    """Return the track after each measurement."""
    state, tracks = new_track("ball"), []
    for number, distance_m in enumerate(distances_m):
        at_s = 1 + number * FRAME_S
        state = step(state, measured("ball", at_s, distance_m, sigma_m), at_s, settings)
        tracks.append(state.track)
    return tracks


def at_rest(times, correlation=0.6, frames=30, runs=40, settings=SETTINGS):
    """Return the last tracks of some runs at 2 m."""
    return [
        tracks_of([2.0 + each for each in noise_of(times, correlation, frames, seed)], settings)[-1]
        for seed in range(runs)
    ]


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_a_target_that_is_four_times_noisier_than_stated_is_known_as_such_within_two_seconds(correlation):
    factors = [track.noise_factor for track in at_rest(4.0, correlation)]
    assert 2.3 <= np.median(factors) <= 5.0


def test_the_noise_of_a_target_that_is_as_noisy_as_stated_is_taken_as_stated():
    factors = [track.noise_factor for track in at_rest(1.0, frames=90)]
    assert np.median(factors) < 1.05
    assert np.quantile(factors, 0.9) < 1.3


def test_what_was_learnt_enters_the_standard_deviation_that_is_published():
    learnt, stated = at_rest(4.0, frames=60), at_rest(4.0, frames=60, settings=replace(SETTINGS, noise_factor_max=1.0))

    def share_inside(tracks):
        return np.mean([abs(track.distance_m - 2.0) < 1.96 * track.sigma_m for track in tracks])

    assert share_inside(learnt) > share_inside(stated) + 0.1
    assert all(track.noise_factor == 1.0 for track in stated)


def test_one_who_knows_better_may_say_how_noisy_targets_are():
    known = replace(SETTINGS, noise_factor=4.0, noise_factor_max=1.0)
    tracks = at_rest(4.0, frames=60, settings=known)
    assert all(track.noise_factor == 4.0 for track in tracks)
    assert np.mean([abs(track.distance_m - 2.0) < 1.645 * track.sigma_m for track in tracks]) > 0.8


def test_a_leap_is_not_learnt_as_noise():
    there, here = noise_of(1.0, 0.6, 60, 3), noise_of(1.0, 0.6, 10, 4)
    tracks = tracks_of([4.0 + each for each in there] + [2.0 + each for each in here])
    assert tracks[-1].distance_m == pytest.approx(2.0, abs=0.05)
    assert tracks[-1].noise_factor < 1.35


def test_single_outliers_are_not_learnt_as_noise():
    factors = []
    for seed in range(20):
        distances_m = 2.0 + np.array(noise_of(1.0, 0.6, 300, seed))
        distances_m[50::50] *= 1.5
        factors.append(tracks_of(distances_m)[-1].noise_factor)
    assert np.median(factors) < 1.3


def test_an_error_that_stays_is_not_averaged_away():
    tracks = tracks_of([2.0] * 150)
    assert tracks[-1].status is TrackStatus.TRACKING
    assert tracks[-1].noise_m == pytest.approx(STATED_M, rel=0.35)
    varies = tracks_of([2.0 + each for each in noise_of(1.0, 0.0, 150, 5)])
    assert varies[-1].noise_m < 0.8 * tracks[-1].noise_m


@given(
    st.floats(-1e3, 1e3),
    st.tuples(st.floats(-1e6, 1e6), st.floats(1e-9, 1e3), st.floats(0, 1e3)),
    st.floats(0, 1e4),
    st.floats(1, 10),
    st.integers(1, 50),
)
def test_whatever_is_seen_the_noise_stays_within_its_bounds(sigmas, line, step_s, factor_max, times):
    settings, noise = replace(SETTINGS, noise_factor_max=factor_max), NoiseEstimate()
    for _ in range(times):
        noise = motion.learn(noise, sigmas, LineDeviation(*line), step_s, settings)
        assert 1.0 <= noise.factor <= factor_max * (1 + 1e-9)
        assert 0.0 <= noise.staying_share <= 1.0
        assert 0.0 <= noise.autocorrelation(settings) <= settings.autocorrelation


@given(st.floats(0.1, 10), st.floats(-5, 5), st.floats(0.01, 0.9), st.floats(0.01, 0.9))
def test_a_steady_speed_is_on_the_line_whatever_the_steps(distance_m, speed_mps, first_s, second_s):
    from stadimeter.core.measurement import Sighting

    def sighting(at_s):
        return Sighting(
            at_s=at_s,
            distance_m=distance_m + speed_mps * at_s,
            noise_m=0.01,
            scale_sigma=0.0,
            depth_share=1.0,
            bearing_rad=0.0,
            elevation_rad=0.0,
        )

    line = motion.compare_with_line(
        NoiseEstimate(), (sighting(0.0), sighting(first_s)), sighting(first_s + second_s), SETTINGS
    )
    assert line.off_m == pytest.approx(0.0, abs=1e-6 * (1 + second_s / first_s))
    assert line.noise_var_m2 > 0
