"""The life of a target."""

import math

import pytest
from msgspec.structs import replace

from stadimeter.core.measurement import MeasurementStatus, TrackStatus
from stadimeter.core.plan import Plan, Tracking
from stadimeter.core.tracking.life_cycle import new_track, step
from support.observing import Rehearsal, measured, missed

SETTINGS = Tracking(confirm_frames=2, coast_s=0.3, outliers_max=3, gate_sigmas=4.0)


def follow(*sights, state=None, start_s=0.0, frame_s=0.1):
    """Step a track through distances; None is a frame without the target."""
    state = state or new_track("ball")
    for index, sight in enumerate(sights):
        at_s = start_s + frame_s * (index + 1)
        seen = missed("ball", at_s) if sight is None else measured("ball", at_s, sight)
        state = step(state, seen, at_s, SETTINGS)
    return state


def test_a_target_counts_only_when_seen_in_enough_frames_in_a_row():
    assert follow(2.0).track.status is TrackStatus.SEARCHING
    assert follow(2.0).track.distance_m is None
    assert "1 of the 2 frames" in follow(2.0).track.reason
    assert follow(2.0, None, 2.0).track.status is TrackStatus.SEARCHING
    assert follow(2.0, 2.0).track.status is TrackStatus.TRACKING


def test_two_sights_that_contradict_each_other_are_not_one_target():
    assert follow(2.0, 9.0).track.status is TrackStatus.SEARCHING


def test_a_short_absence_is_bridged_by_prediction_that_grows_less_sure():
    tracked = follow(2.0, 1.95, 1.9, 1.85, 1.8)
    coasting = follow(None, None, state=tracked, start_s=0.5)
    assert coasting.track.status is TrackStatus.COASTING
    assert coasting.track.distance_m < tracked.track.distance_m
    assert coasting.track.sigma_m > tracked.track.sigma_m
    assert coasting.track.reason == "no blob"


def test_a_target_that_stays_away_is_lost_and_says_why():
    lost = follow(None, None, None, None, state=follow(2.0, 2.0), start_s=0.2)
    assert lost.track.status is TrackStatus.LOST
    assert lost.track.reason == "not measured for 0.40 s, limit 0.30 s: no blob"


def test_a_target_is_lost_even_if_no_frame_comes_at_all():
    state = step(follow(2.0, 2.0), None, 0.6, SETTINGS)
    assert state.track.status is TrackStatus.LOST
    assert "no new frame" in state.track.reason


def test_a_lost_target_must_be_confirmed_again():
    lost = follow(*[None] * 5, state=follow(2.0, 2.0), start_s=0.2)
    once = follow(3.0, state=lost, start_s=0.8)
    assert once.track.status is TrackStatus.LOST
    assert follow(3.0, state=once, start_s=0.9).track.status is TrackStatus.TRACKING


def test_an_outlier_does_not_move_the_track():
    before = follow(*[2.0] * 10)
    state = follow(7.0, state=before, start_s=1.0)
    assert state.track.distance_m == pytest.approx(2.0, abs=0.01)
    assert state.track.rejected == 1
    assert "outlier 1 of 3: 7.00 m" in state.track.reason


def test_outliers_that_agree_for_three_frames_mean_that_the_target_jumped():
    slow = Tracking(confirm_frames=2, coast_s=5.0, outliers_max=5)
    state = follow(*[2.0] * 10)
    for index in range(3):
        assert state.track.distance_m == pytest.approx(2.0, abs=0.05)
        at_s = 1.1 + 0.1 * index
        state = step(state, measured("ball", at_s, 7.0), at_s, slow)
    assert state.track.status is TrackStatus.TRACKING
    assert state.track.distance_m == 7.0


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf, 0.0, -1.0])
def test_a_figure_that_is_no_distance_is_a_frame_without_the_target(broken):
    state = follow(2.0, 2.0, broken)
    assert state.track.status is TrackStatus.COASTING
    assert math.isfinite(state.track.distance_m)


def test_a_frame_that_comes_twice_tells_nothing_new():
    state = follow(2.0, 2.1)
    assert step(state, measured("ball", 0.2, 2.1), 0.25, SETTINGS) is state
    assert step(state, measured("ball", 0.15, 9.0), 0.25, SETTINGS) is state


def test_what_no_filter_can_reduce_stays_in_the_standard_deviation():
    state = new_track("ball")
    for index in range(100):
        at_s = 0.1 * (index + 1)
        seen = replace(measured("ball", at_s, 2.0, sigma_m=0.01), sigma_m=0.05)
        state = step(state, seen, at_s, SETTINGS)
    assert state.track.sigma_m >= math.sqrt(0.05**2 - 0.01**2)
    assert state.track.noise_m < 0.01
    assert state.track.sigma_m == pytest.approx(math.hypot(state.track.noise_m, math.sqrt(0.05**2 - 0.01**2)), rel=1e-6)


def perhaps(at_s, distance_m):
    """Return a measurement of what may be another thing."""
    return replace(measured("ball", at_s, distance_m), status=MeasurementStatus.PERHAPS, reason="a pale rim")


def follow_perhaps(*sights_m, state=None, start_s=0.0):
    state = state or new_track("ball")
    for index, sight_m in enumerate(sights_m):
        at_s = start_s + 0.1 * (index + 1)
        state = step(state, perhaps(at_s, sight_m), at_s, SETTINGS)
    return state


def test_what_is_perhaps_the_target_counts_only_when_it_has_been_the_same_thing_in_ten_frames_in_a_row():
    nine = follow_perhaps(*[2.0] * 9)
    assert nine.track.status is TrackStatus.SEARCHING
    assert nine.track.reason == "perhaps seen in 9 of the 10 frames in a row that it takes: a pale rim"
    assert follow(None, state=nine, start_s=0.9).candidate is None
    assert follow_perhaps(2.0, state=nine, start_s=0.9).track.status is TrackStatus.TRACKING
    elsewhere = follow_perhaps(*[2.0] * 5, *[9.0] * 5)
    assert elsewhere.track.status is TrackStatus.SEARCHING


def test_a_target_that_is_surely_seen_counts_as_soon_as_ever_among_frames_with_perhaps():
    once = follow(2.0, state=follow_perhaps(2.0, 2.0), start_s=0.2)
    assert once.track.status is TrackStatus.SEARCHING
    assert follow(2.0, state=once, start_s=0.3).track.status is TrackStatus.TRACKING


def test_two_that_contradict_each_other_and_a_third_between_are_no_fast_target_if_one_is_only_perhaps_there():
    assert follow(2.0, 4.0, 6.0).track.status is TrackStatus.TRACKING
    assert follow(6.0, state=follow_perhaps(2.0, 4.0), start_s=0.2).track.status is TrackStatus.SEARCHING


def test_a_target_that_is_followed_goes_on_where_it_is_perhaps_seen_and_says_why():
    state = follow_perhaps(2.0, 2.0, state=follow(2.0, 2.0), start_s=0.2)
    assert state.track.status is TrackStatus.TRACKING
    assert state.track.reason == "a pale rim"


def test_what_is_perhaps_the_target_and_elsewhere_never_takes_a_track_over():
    state = follow_perhaps(*[7.0] * 3, state=follow(2.0, 2.0), start_s=0.2)
    assert state.track.status is TrackStatus.COASTING
    assert state.track.distance_m == pytest.approx(2.0, abs=0.05)
    lost = follow_perhaps(7.0, state=state, start_s=0.5)
    assert lost.track.status is TrackStatus.LOST


def test_it_is_known_since_when_a_target_has_been_in_sight_or_out_of_it():
    assert follow(None).track.since_s == 0.1
    seen = follow(2.0, 2.0, 2.0, 2.0)
    assert seen.track.since_s == 0.2
    coasting = follow(None, 2.0, state=seen, start_s=0.4)
    assert coasting.track.since_s == 0.2
    lost = follow(*[None] * 5, state=coasting, start_s=0.6)
    assert lost.track.status is TrackStatus.LOST
    assert lost.track.since_s == pytest.approx(1.0)


def test_distance_and_closing_speed_err_against_each_other():
    # A distance that is taken for too large was approached too slowly, as far as the filter can tell.
    tracked = follow(2.0, 1.9, 1.8, 1.7)
    assert tracked.track.closing_cov_m2ps < 0
    sigmas = tracked.track.sigma_m * tracked.track.closing_sigma_mps
    assert abs(tracked.track.closing_cov_m2ps) < sigmas


def test_one_wrong_measurement_that_a_manoeuvre_could_explain_is_not_believed():
    run = seen_at(*[0.51] * 30, sigma_m=0.0004)
    shown = run.see(0.48, sigma_m=0.0004).tracks[0]
    assert (shown.status, shown.rejected) == (TrackStatus.COASTING, 1)
    assert shown.distance_m == pytest.approx(0.51, abs=0.001)
    assert "the next frame tells" in shown.reason
    shown = run.see(0.51, sigma_m=0.0004).tracks[0]
    assert (shown.status, shown.rejected) == (TrackStatus.TRACKING, 0)
    assert shown.distance_m == pytest.approx(0.51, abs=0.001)


def test_a_target_that_really_starts_is_followed_from_its_second_frame():
    run = seen_at(*[0.51] * 30, sigma_m=0.0004)
    shown = run.see(0.48, 0.45, sigma_m=0.0004).tracks[0]
    assert shown.status is TrackStatus.TRACKING
    assert shown.distance_m == pytest.approx(0.45, abs=0.005)


def test_two_wrong_measurements_that_contradict_each_other_are_not_believed():
    run = seen_at(*[0.51] * 30, sigma_m=0.0004)
    run.see(0.485, sigma_m=0.0004)
    assert run.see(0.535, sigma_m=0.0004).tracks[0].distance_m == pytest.approx(0.51, abs=0.002)
    assert run.see(0.51, sigma_m=0.0004).tracks[0].distance_m == pytest.approx(0.51, abs=0.002)


def seen_at(*distances_m, sigma_m):
    run = Rehearsal(Plan(targets=("ball",)), frame_s=1 / 30)
    run.see(*distances_m, sigma_m=sigma_m)
    return run


@pytest.mark.parametrize(("by", "most"), [(0.03, 1.66), (0.06, 1.75), (0.1, 2.1)])
def test_an_error_towards_the_camera_counts_for_little_more_than_one_away_from_it(by, most):
    """The stated noise grows with the square of the measured distance, so what seems near seems sure."""
    settled, settings = new_track("box"), Tracking()
    for number in range(1, 61):
        seen_m = 8.0 + 0.2 * (-1) ** number
        settled = step(settled, measured("box", number / 15, seen_m, 0.006 * seen_m**2), number / 15, settings)

    def share(seen_m):
        pulled = step(settled, measured("box", 61 / 15, seen_m, 0.006 * seen_m**2), 61 / 15, settings)
        return (pulled.track.distance_m - settled.track.distance_m) / (seen_m - settled.track.distance_m)

    assert share(8.0 / (1 + by)) < most * share(8.0 / (1 - by))
