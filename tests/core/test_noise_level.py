"""What is learnt of a target's noise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.measurement import TrackStatus
from stadimeter.core.plan import Tracking
from stadimeter.core.tracking import motion
from stadimeter.core.tracking.life_cycle import new_track, step
from stadimeter.core.tracking.motion import LineDeviation, NoiseEstimate
from support.observing import measured

FRAME_S = 1 / 15
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
