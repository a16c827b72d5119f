"""The life of a target, with its counts, times and signs to the last one."""

import math

import pytest
from msgspec.structs import replace

from stadimeter.core.measurement import MeasurementStatus, TrackStatus
from stadimeter.core.plan import Plan, Tracking
from stadimeter.core.tracking.life_cycle import after_gap, new_track, step
from support.each_case import each_case
from support.observing import Rehearsal, measured, missed

# The life of a target.

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
    assert "waiting for more frames" in shown.reason
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


# Edges of a track's life that its other tests left open: counts, times and signs, each to the last one.

FRAME_S = 0.1
THREE_FRAMES = Tracking(confirm_frames=3, coast_s=0.3, outliers_max=3, gate_sigmas=4.0)


def see(state, *distances_m, start_s=None, settings=THREE_FRAMES):
    """Step a track through a frame for each distance; None is a frame without the target."""
    at_s = state.filter_at_s if start_s is None else start_s
    at_s = at_s if math.isfinite(at_s) else 0.0
    for distance_m in distances_m:
        at_s += FRAME_S
        seen = missed("ball", at_s) if distance_m is None else measured("ball", at_s, distance_m)
        state = step(state, seen, at_s, settings)
    return state


def tracked(distance_m=2.0, frames=20, **settings):
    return see(new_track("ball"), *[distance_m] * frames, settings=replace(THREE_FRAMES, **settings))


FAR_APART_M = (50.0, 100.0, 7.0, 70.0, 30.0, 90.0)


@pytest.mark.parametrize("outliers_max", [1, 2, 3, 5])
def test_as_many_outliers_as_allowed_are_refused_and_one_more_is_believed(outliers_max):
    settings = replace(THREE_FRAMES, outliers_max=outliers_max, coast_s=10.0)
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
    settings = replace(THREE_FRAMES, coast_s=10.0, outliers_max=5)
    state = see(tracked(coast_s=10.0, outliers_max=5), 7.0, None, 7.0, None, 7.0, settings=settings)
    assert state.track.distance_m == pytest.approx(7.0, abs=0.05)


def test_outliers_that_the_target_is_seen_between_are_forgotten():
    settings = replace(THREE_FRAMES, coast_s=10.0, outliers_max=5)
    state = see(tracked(coast_s=10.0, outliers_max=5), 7.0, 7.0, 2.0, 7.0, 7.0, settings=settings)
    assert state.track.status is TrackStatus.COASTING
    assert state.track.distance_m == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("speed_mps", [-30.0, -12.0, 12.0, 30.0])
def test_a_very_fast_target_is_confirmed_by_three_frames_on_a_line(speed_mps):
    settings = replace(THREE_FRAMES, confirm_frames=2)
    distances_m = [15.0 + speed_mps * FRAME_S * number for number in range(4)]
    assert see(new_track("ball"), *distances_m[:2], settings=settings).track.status is TrackStatus.SEARCHING
    state = see(new_track("ball"), *distances_m[:3], settings=settings)
    assert state.track.status is TrackStatus.TRACKING
    assert state.track.closing_mps == pytest.approx(-speed_mps, abs=0.5)
    assert see(state, distances_m[3], settings=settings).track.distance_m == pytest.approx(distances_m[3], abs=0.05)


def test_three_sights_that_are_on_no_line_are_no_target():
    settings = replace(THREE_FRAMES, confirm_frames=2)
    assert see(new_track("ball"), 12.0, 14.0, 12.5, settings=settings).track.status is TrackStatus.SEARCHING


def test_a_line_that_no_target_is_fast_enough_for_is_none():
    settings = replace(THREE_FRAMES, confirm_frames=2)
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
    state = step(tracked(), broken, 2.1, THREE_FRAMES)
    assert state.track.status is TrackStatus.COASTING
    assert state.track.reason == "the measurement holds no usable figures"


@pytest.mark.parametrize("distance_m", [0.0, -1.0])
def test_a_distance_that_cannot_be_counts_as_a_miss(distance_m):
    state = step(tracked(), replace(measured("ball", 2.1, 2.0), distance_m=distance_m), 2.1, THREE_FRAMES)
    assert state.track.status is TrackStatus.COASTING


def test_a_track_shows_what_its_measurements_say():
    state = new_track("ball")
    for number in range(40):
        at_s = FRAME_S * (number + 1)
        distance_m = 5.0 - 0.5 * at_s
        seen = replace(
            measured("ball", at_s, distance_m, bearing_rad=0.2), depth_m=0.8 * distance_m, elevation_rad=-0.1
        )
        state = step(state, seen, at_s, THREE_FRAMES)
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
    assert "waiting for more frames" in first.track.reason
    believed = see(first, 1.8)
    assert believed.track.status is TrackStatus.TRACKING
    settled = see(believed, *[1.8] * 10)
    assert see(settled, 2.0).track.status is TrackStatus.TRACKING


def test_a_target_that_has_been_at_rest_for_long_is_doubted_again():
    believed = see(tracked(), 1.8, 1.8)
    settled = see(believed, *[1.8] * 40)
    assert see(settled, 2.0).track.status is TrackStatus.COASTING
