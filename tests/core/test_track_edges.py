"""Edges of a track's life that its other tests left open: counts, times and signs, each to the last one."""

import math

import pytest
from msgspec.structs import replace

from stadimeter.core.measurement import TrackStatus
from stadimeter.core.plan import Tracking
from stadimeter.core.tracking.life_cycle import after_gap, new_track, step
from support.each_case import each_case
from support.observing import measured, missed

FRAME_S = 0.1
SETTINGS = Tracking(confirm_frames=3, coast_s=0.3, outliers_max=3, gate_sigmas=4.0)


def see(state, *distances_m, start_s=None, settings=SETTINGS):
    """Step a track through a frame for each distance; None is a frame without the target."""
    at_s = state.filter_at_s if start_s is None else start_s
    at_s = at_s if math.isfinite(at_s) else 0.0
    for distance_m in distances_m:
        at_s += FRAME_S
        seen = missed("ball", at_s) if distance_m is None else measured("ball", at_s, distance_m)
        state = step(state, seen, at_s, settings)
    return state


def tracked(distance_m=2.0, frames=20, **settings):
    return see(new_track("ball"), *[distance_m] * frames, settings=replace(SETTINGS, **settings))


FAR_APART_M = (50.0, 100.0, 7.0, 70.0, 30.0, 90.0)


@pytest.mark.parametrize("outliers_max", [1, 2, 3, 5])
def test_as_many_outliers_as_allowed_are_refused_and_one_more_is_believed(outliers_max):
    settings = replace(SETTINGS, outliers_max=outliers_max, coast_s=10.0)
    state = tracked(outliers_max=outliers_max, coast_s=10.0)
    for number, distance_m in enumerate(FAR_APART_M[:outliers_max], start=1):
        state = see(state, distance_m, settings=settings)
        assert state.track.status is TrackStatus.COASTING
        assert state.track.rejected == number
        assert state.track.distance_m == pytest.approx(2.0, abs=0.05)
    state = see(state, FAR_APART_M[outliers_max], settings=settings)
    assert state.track.status is TrackStatus.TRACKING
    assert state.track.distance_m == pytest.approx(FAR_APART_M[outliers_max], abs=0.05)
    assert state.track.rejected == 0


def test_frames_without_the_target_between_outliers_that_agree_do_not_count_against_them():
    settings = replace(SETTINGS, coast_s=10.0, outliers_max=5)
    state = see(tracked(coast_s=10.0, outliers_max=5), 7.0, None, 7.0, None, 7.0, settings=settings)
    assert state.track.distance_m == pytest.approx(7.0, abs=0.05)


def test_outliers_that_the_target_is_seen_between_are_forgotten():
    settings = replace(SETTINGS, coast_s=10.0, outliers_max=5)
    state = see(tracked(coast_s=10.0, outliers_max=5), 7.0, 7.0, 2.0, 7.0, 7.0, settings=settings)
    assert state.track.status is TrackStatus.COASTING
    assert state.track.distance_m == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("speed_mps", [-30.0, -12.0, 12.0, 30.0])
def test_a_very_fast_target_is_confirmed_by_three_frames_on_a_line(speed_mps):
    settings = replace(SETTINGS, confirm_frames=2)
    distances_m = [15.0 + speed_mps * FRAME_S * number for number in range(4)]
    assert see(new_track("ball"), *distances_m[:2], settings=settings).track.status is TrackStatus.SEARCHING
    state = see(new_track("ball"), *distances_m[:3], settings=settings)
    assert state.track.status is TrackStatus.TRACKING
    assert state.track.closing_mps == pytest.approx(-speed_mps, abs=0.5)
    assert see(state, distances_m[3], settings=settings).track.distance_m == pytest.approx(distances_m[3], abs=0.05)


def test_three_sights_that_are_on_no_line_are_no_target():
    settings = replace(SETTINGS, confirm_frames=2)
    assert see(new_track("ball"), 12.0, 14.0, 12.5, settings=settings).track.status is TrackStatus.SEARCHING


def test_a_line_that_no_target_is_fast_enough_for_is_none():
    settings = replace(SETTINGS, confirm_frames=2)
    assert see(new_track("ball"), 5.0, 10.0, 15.0, settings=settings).track.status is TrackStatus.SEARCHING


def test_a_miss_begins_the_row_anew_and_says_why():
    state = see(new_track("ball"), 2.0, 2.0, None)
    assert state.track.reason == "no blob"
    assert see(state, 2.0, 2.0, start_s=0.3).track.status is TrackStatus.SEARCHING
    assert see(state, 2.0, 2.0, 2.0, start_s=0.3).track.status is TrackStatus.TRACKING


def test_a_contradiction_begins_the_row_anew_with_itself():
    state = see(new_track("ball"), 2.0, 2.0, 9.0)
    assert state.track.status is TrackStatus.SEARCHING
    assert see(state, 9.0).track.status is TrackStatus.SEARCHING
    assert see(state, 9.0, 9.0).track.distance_m == pytest.approx(9.0, abs=0.05)


def test_a_target_that_was_lost_begins_its_row_anew():
    lost = see(tracked(), *[None] * 5)
    assert lost.track.status is TrackStatus.LOST
    at_s = 20 * FRAME_S + 0.5
    assert see(lost, 2.0, 2.0, start_s=at_s).track.status is TrackStatus.LOST
    assert see(lost, 2.0, 2.0, 2.0, start_s=at_s).track.status is TrackStatus.TRACKING


def test_a_gap_begins_the_row_and_the_time_out_of_sight_anew():
    gap = after_gap(tracked(), 50.0, "the program stood still")
    assert (gap.track.status, gap.track.reason, gap.track.since_s) == (
        TrackStatus.LOST,
        "the program stood still",
        50.0,
    )
    searching = after_gap(see(new_track("ball"), 2.0, 2.0), 50.0, "the program stood still")
    assert see(searching, 2.0, 2.0, start_s=50.0).track.status is TrackStatus.SEARCHING


@each_case("figure", ["distance_m", "depth_m", "sigma_m", "noise_m", "bearing_rad", "elevation_rad"])
@each_case("value", [None, math.nan, math.inf, -math.inf])
def test_a_measurement_with_a_missing_or_endless_figure_counts_as_a_miss(figure, value):
    broken = replace(measured("ball", 2.1, 2.0), **{figure: value})
    state = step(tracked(), broken, 2.1, SETTINGS)
    assert state.track.status is TrackStatus.COASTING
    assert state.track.reason == "the measurement holds no usable figures"


@pytest.mark.parametrize("distance_m", [0.0, -1.0])
def test_a_distance_that_cannot_be_counts_as_a_miss(distance_m):
    state = step(tracked(), replace(measured("ball", 2.1, 2.0), distance_m=distance_m), 2.1, SETTINGS)
    assert state.track.status is TrackStatus.COASTING


def test_a_track_shows_what_its_measurements_say():
    state = new_track("ball")
    for number in range(40):
        at_s = FRAME_S * (number + 1)
        distance_m = 5.0 - 0.5 * at_s
        seen = replace(
            measured("ball", at_s, distance_m, bearing_rad=0.2), depth_m=0.8 * distance_m, elevation_rad=-0.1
        )
        state = step(state, seen, at_s, SETTINGS)
    track = state.track
    assert track.closing_mps == pytest.approx(0.5, abs=0.05)
    assert track.depth_m == pytest.approx(0.8 * track.distance_m)
    assert (track.bearing_rad, track.elevation_rad) == (0.2, -0.1)
    assert track.as_of_s == track.measured_at_s == pytest.approx(4.0)


def test_a_prediction_is_for_the_time_of_the_frame_and_measured_when_it_was():
    state = see(tracked(), None)
    assert state.track.as_of_s == pytest.approx(2.1)
    assert state.track.measured_at_s == pytest.approx(2.0)


def test_a_target_that_really_leapt_may_leap_again_without_a_frame_of_doubt():
    """Near the camera a first leap within what a manoeuvre allows waits for one frame; the next ones do not."""
    state = tracked()
    first = see(state, 1.8)
    assert first.track.status is TrackStatus.COASTING
    assert "the next frame tells" in first.track.reason
    believed = see(first, 1.8)
    assert believed.track.status is TrackStatus.TRACKING
    settled = see(believed, *[1.8] * 10)
    assert see(settled, 2.0).track.status is TrackStatus.TRACKING


def test_a_target_that_has_been_at_rest_for_long_is_doubted_again():
    believed = see(tracked(), 1.8, 1.8)
    settled = see(believed, *[1.8] * 40)
    assert see(settled, 2.0).track.status is TrackStatus.COASTING
