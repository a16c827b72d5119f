"""Whether a simple condition holds."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.compounds import judge
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.evidence import collect_evidence, describe_begin, describe_end, describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.conditions.remembered import RememberedCondition, Window
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.sight import CountCondition, PresenceCondition
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.observation import WallTime
from support.conditions import closing, direction, separation
from support.each_case import each_case

MONDAY, TUESDAY, SUNDAY = 0, 1, 6
HOUR_S = 3600.0


def track(distance_m=2.0, sigma_m=0.02, status=TrackStatus.TRACKING, target="ball", **more):
    figures = {
        "depth_m": distance_m,
        "closing_mps": 0.0,
        "closing_sigma_mps": 0.1,
        "bearing_rad": 0.0,
        "elevation_rad": 0.0,
        "since_s": 0.0,
        "closing_cov_m2ps": 0.0,
    }
    return Track(target=target, status=status, distance_m=distance_m, sigma_m=sigma_m, **{**figures, **more})


def inputs(*tracks, now_s=10.0, **more):
    return RuleInputs(tracks={each.target: each for each in tracks or (track(),)}, now_s=now_s, **more)


def holds(condition, *tracks, is_active=False, **more):
    return judge(condition, inputs(*tracks, **more), (), is_active=is_active).value


def words(condition, *tracks, is_active=False, **more):
    return describe_verdict(condition, inputs(*tracks, **more), (), is_active=is_active, with_probability=True)


NEAR = DistanceCondition(below=1.0, probability_on=0.8, target="ball")


def test_it_begins_when_it_is_likely_enough():
    assert holds(NEAR, track(0.97)) is True
    assert holds(NEAR, track(0.99)) is False  # P = 0.69
    assert holds(NEAR, track(1.03)) is False


def test_once_begun_it_lasts_until_the_deadband_is_left():
    assert holds(NEAR, track(1.05), is_active=True) is True
    assert holds(NEAR, track(1.08), is_active=True) is False


def test_the_reason_names_the_figures():
    assert words(NEAR, track(0.99)) == "0.99 m ± 0.02, below 1.00 m: P 0.69, begins at 0.80"
    assert words(NEAR, track(1.05), is_active=True) == "1.05 m ± 0.02, below 1.05 m: P 0.59, ends at 0.50"
    assert describe_verdict(NEAR, inputs(track(0.99)), (), is_active=False) == "0.99 m ± 0.02, below 1.00 m"


FIGURES = [
    NEAR,
    direction(above=0.1, target="ball"),
    direction(quantity="elevation", below=0.1, target="ball"),
    closing(above=0.1, target="ball"),
    TimeToContactCondition(below_s=2.0, target="ball"),
    separation(targets=("ball", "tag"), below=1.0),
]


@each_case("condition", FIGURES)
@each_case("status", [TrackStatus.LOST, TrackStatus.SEARCHING])
@each_case("is_active", [True, False])
def test_without_the_target_nothing_is_known(condition, status, is_active):
    tracks = track(0.5, status=status, reason="no blob"), track(target="tag")
    assert holds(condition, *tracks, is_active=is_active) is None
    assert words(condition, *tracks, is_active=is_active) == f"ball is {status.value}: no blob"


@each_case("condition", FIGURES)
@each_case("broken", [math.nan, math.inf, None])
def test_a_figure_that_is_not_finite_is_not_known_either(condition, broken):
    figures = {"closing_mps": broken, "bearing_rad": broken, "elevation_rad": broken}
    assert holds(condition, track(broken, **figures), track(target="tag")) is None
    if condition.unit != "rad":
        sigmas = {"sigma_m": broken, "closing_sigma_mps": broken}
        assert holds(condition, track(0.5, **sigmas), track(target="tag")) is None


def test_a_count_of_raises_says_the_number_that_is_enough_everywhere():
    twice = RememberedCondition(rules=("near",), unit="times", above=1.0, window=Window(for_s=60.0), owner="often")
    once = inputs(figures={twice.key: 1.0})
    (found,) = collect_evidence(twice, once, (), is_active=False)
    assert found.words == "near raised 1 of 2 times within 1 min"
    assert found.begins_at == "2 times"
    assert describe_begin(twice) == "`near` was raised at least 2 times within 1 min"
    assert describe_end(twice) == "`near` was raised fewer than 2 times within 1 min"
    (found,) = collect_evidence(twice, inputs(figures={twice.key: 2.0}), (), is_active=True)
    assert found.ends_at == "1 times"


def test_plain_comparison_is_there_for_who_wants_it():
    plain = replace(NEAR, probability_on=None, deadband_sigmas=0.0, deadband=0.1)
    assert holds(plain, track(0.999, sigma_m=0.5)) is True
    assert holds(plain, track(1.09, sigma_m=0.5), is_active=True) is True
    assert holds(plain, track(1.11, sigma_m=0.5), is_active=True) is False
    assert words(plain, track(0.5)) == "0.50 m ± 0.02, below 1.00 m"


BAND = DistanceCondition(above=0.9, below=1.0, target="ball")


@pytest.mark.parametrize(("first_m", "then_m"), [(3.0, 0.4), (0.4, 3.0)])
@pytest.mark.parametrize("sure", [0.8, None])
def test_a_target_that_goes_through_a_band_between_two_frames_was_in_it(first_m, then_m, sure):
    now = {"before": {"ball": track(first_m)}}
    band = replace(BAND, probability_on=sure)
    assert holds(band, track(then_m), **now) is True
    assert words(band, track(then_m), **now) == (
        f"passed through between two frames: {first_m:.2f} m, then {then_m:.2f} m"
    )
    assert holds(band, track(then_m), is_active=True, **now) is False


@pytest.mark.parametrize(
    ("before", "now"),
    [
        (track(3.0), track(1.2)),
        (track(3.0, status=TrackStatus.LOST), track(0.4)),
        (track(3.0, sigma_m=5.0), track(0.4)),
        (track(1.01), track(0.4)),  # it may have been in the band before, and was judged then
    ],
)
def test_a_target_that_did_not_surely_go_through_a_band_was_not_in_it(before, now):
    assert holds(BAND, now, before={"ball": before}) is False


def test_presence_is_always_known():
    seen, lost = PresenceCondition(seen=True, target="ball"), PresenceCondition(seen=False, target="ball")
    for status in TrackStatus:
        is_seen = status in {TrackStatus.TRACKING, TrackStatus.COASTING}
        assert holds(seen, track(1.0, status=status)) is is_seen
        assert holds(lost, track(1.0, status=status)) is not is_seen


def test_seen_for_a_time_begins_when_the_time_is_over():
    long_seen = PresenceCondition(seen=True, for_s=5.0, target="ball")
    at_7 = track(since_s=7.0)
    assert holds(long_seen, at_7, now_s=11.99) is False
    assert holds(long_seen, at_7, now_s=12.0) is True
    assert words(long_seen, at_7, now_s=9.0) == "ball is tracking for 2.0 s of 5 s"


def test_lost_for_a_time_counts_from_when_it_was_lost():
    long_lost = PresenceCondition(seen=False, for_s=5.0, target="ball")
    gone = track(status=TrackStatus.LOST, since_s=7.0, reason="no blob")
    assert holds(long_lost, gone, now_s=11.0) is False
    assert holds(long_lost, gone, now_s=12.0) is True
    assert holds(long_lost, track(since_s=0.0), now_s=12.0) is False
    assert words(long_lost, gone, now_s=8.0) == "ball is lost for 1.0 s of 5 s: no blob"


def test_a_bearing_is_compared_as_it_is_and_ends_beyond_its_deadband():
    right = direction(above=0.2, deadband=0.05, target="ball")
    assert holds(right, track(bearing_rad=0.21)) is True
    assert holds(right, track(bearing_rad=0.19)) is False
    assert holds(right, track(bearing_rad=0.16), is_active=True) is True
    assert holds(right, track(bearing_rad=0.14), is_active=True) is False
    assert words(right, track(bearing_rad=-0.2)) == "bearing -11.5°, not above 11.5°"


def test_a_closing_speed_counts_when_it_is_sure_enough():
    fast = closing(above=0.5, probability_on=0.8, target="ball")
    assert holds(fast, track(closing_mps=0.6, closing_sigma_mps=0.05)) is True
    assert holds(fast, track(closing_mps=0.6, closing_sigma_mps=0.5)) is False
    assert holds(fast, track(closing_mps=0.42, closing_sigma_mps=0.05), is_active=True) is True
    assert words(fast, track(closing_mps=0.6, closing_sigma_mps=0.05)) == (
        "closing at 0.60 m/s ± 0.05, above 0.50 m/s: P 0.98, begins at 0.80"
    )


SOON = TimeToContactCondition(below_s=2.0, probability_on=0.8, closing_min_mps=0.3, target="ball")


def coming(distance_m, closing_mps, closing_sigma_mps=0.05, **more):
    return track(distance_m, closing_mps=closing_mps, closing_sigma_mps=closing_sigma_mps, **more)


def test_a_target_that_will_be_here_soon_is_noticed():
    assert holds(SOON, coming(1.5, 1.0)) is True
    assert holds(SOON, coming(2.5, 1.0)) is False
    assert holds(SOON, coming(2.3, 1.0), is_active=True) is True
    assert holds(SOON, coming(3.0, 1.0), is_active=True) is False


def test_contact_may_be_before_the_camera_is_reached():
    assert holds(replace(SOON, contact_m=1.0), coming(2.5, 1.0)) is True
    assert words(replace(SOON, contact_m=1.0), coming(2.5, 1.0)) == (
        "contact in 1.50 s ± 0.08, below 2.00 s: P 1.00, begins at 0.80"
    )


def test_the_time_to_contact_is_as_unsure_as_distance_and_speed_are():
    unsure = coming(1.9, 1.0, 0.3)
    # d − v·T = −0.1 m ± hypot(0.02, 2 · 0.3), so P = Φ(0.1 / 0.6) = 0.57
    assert holds(SOON, unsure) is False
    assert "P 0.57" in words(SOON, unsure)
    # errors of distance and speed that go together leave the time surer than errors that go against each other
    together, against = replace(unsure, closing_cov_m2ps=0.005), replace(unsure, closing_cov_m2ps=-0.005)
    assert "± 0.55" in words(SOON, together)
    assert "± 0.59" in words(SOON, against)


def test_a_target_that_surely_creeps_does_not_come():
    assert holds(SOON, coming(0.3, 0.1, 0.02)) is False
    assert holds(SOON, coming(0.3, -1.0)) is False
    assert words(SOON, coming(0.3, 0.1, 0.02)) == "closing at 0.10 m/s ± 0.02, slower than 0.30 m/s"


def test_a_speed_that_may_be_zero_says_nothing_of_a_target_that_is_near():
    assert holds(SOON, coming(0.3, 0.4, 0.3)) is None
    assert holds(SOON, coming(0.3, 0.2, 0.3)) is None
    assert words(SOON, coming(0.3, 0.4, 0.3)) == "0.30 m ± 0.02, closing at 0.40 m/s ± 0.30: too unsure for a time"


def test_a_target_so_far_away_that_no_plausible_speed_brings_it_here_does_not_come():
    assert holds(SOON, coming(5.0, 0.4, 0.3)) is False  # at most 1.0 m/s for 2.5 s
    assert holds(SOON, coming(5.0, 0.1, 0.3), is_active=True) is False


def test_without_a_probability_the_time_is_compared_as_it_is():
    plain = replace(SOON, probability_on=None, deadband_sigmas=0.0)
    assert holds(plain, coming(1.9, 1.0, 5.0)) is True
    assert holds(plain, coming(2.1, 1.0, 5.0)) is False
    assert holds(plain, coming(2.4, 1.0, 5.0), is_active=True) is True
    assert holds(plain, coming(0.1, 0.2, 5.0)) is False
    assert words(plain, coming(2.0, 1.0, 0.1)) == "contact in 2.00 s ± 0.20, not below 2.00 s"


def at(target, distance_m, bearing_rad, elevation_rad=0.0, sigma_m=0.03):
    return track(distance_m, sigma_m, target=target, bearing_rad=bearing_rad, elevation_rad=elevation_rad)


APART = separation(targets=("ball", "tag"), below=1.0)


def test_two_targets_beside_each_other_are_apart_by_their_directions():
    ball, tag = at("ball", 2.0, 0.2), at("tag", 2.0, -0.2)  # 2 · 2 m · sin 0.2 = 0.795 m
    assert words(APART, ball, tag).startswith("ball and tag 0.795 m ± 0.008 apart, below 1.00 m")
    assert holds(APART, ball, tag) is True
    assert holds(APART, at("ball", 2.0, 0.3), at("tag", 2.0, -0.3)) is False


def test_two_targets_behind_each_other_are_as_unsure_as_both_distances():
    assert words(APART, at("ball", 2.0, 0.1, 0.1), at("tag", 3.2, 0.1, 0.1)).startswith(
        "ball and tag 1.20 m ± 0.04 apart, not below 1.00 m: P 0.00"
    )


def test_directions_mean_the_same_as_in_a_measurement():
    above = at("tag", 2.0, 0.0, math.radians(30))
    ahead = at("ball", 2.0, 0.0)
    assert holds(replace(APART, below=1.1), ahead, above) is True  # 2 · 2 m · sin 15° = 1.035 m
    assert holds(replace(APART, below=1.0), ahead, above) is False


def test_targets_in_sight_are_counted():
    tracks = track(), track(target="tag"), track(target="cup", status=TrackStatus.LOST)
    assert holds(CountCondition(at_least=2), *tracks) is True
    assert holds(CountCondition(at_least=3), *tracks) is False
    assert holds(CountCondition(at_most=1), *tracks) is False
    assert holds(CountCondition(at_least=2, targets=("ball", "cup")), *tracks) is False
    assert words(CountCondition(at_least=1, at_most=2), *tracks) == "2 of 3 in sight, at least 1 and at most 2"


def test_another_rule_is_active_or_not_or_knows_nothing():
    muted = RuleCondition(rule="mute")
    assert holds(muted, active={"mute": True}) is True
    assert holds(muted, active={"mute": False}) is False
    assert holds(muted, active={"mute": None}) is None
    assert holds(muted) is None
    assert words(muted, active={"mute": None}) == "the rule mute has nothing to judge by"


def at_time(hours, weekday=MONDAY):
    return {"wall": WallTime(second_of_day=hours * HOUR_S, weekday=weekday)}


NIGHT = ScheduleCondition(from_s=22 * HOUR_S, to_s=6 * HOUR_S)
MONDAY_NIGHT = replace(NIGHT, weekdays=(MONDAY,))


def test_a_schedule_is_unknown_while_the_clock_is():
    assert holds(NIGHT) is None
    assert words(NIGHT) == "the time of day is not known yet, between 22:00 and 06:00"
    assert words(MONDAY_NIGHT, **at_time(23.5)) == "Monday 23:30, between 22:00 and 06:00 on Monday"


SIMPLE = st.one_of(
    st.builds(
        DistanceCondition,
        above=st.none() | st.floats(0.5, 2.0),
        below=st.none() | st.floats(0.5, 4.0),
        deadband=st.floats(0, 0.5),
        deadband_sigmas=st.floats(0, 4),
        probability_on=st.none() | st.floats(0.05, 0.95),
        probability_off=st.floats(0.05, 0.95),
        target=st.just("ball"),
    ),
    st.builds(
        TimeToContactCondition,
        below_s=st.floats(0.5, 5),
        contact_m=st.floats(0, 1),
        closing_min_mps=st.floats(0, 0.5),
        deadband_s=st.floats(0, 1),
        deadband_sigmas=st.floats(0, 3),
        probability_on=st.none() | st.floats(0.5, 0.9),
        probability_off=st.floats(0.1, 0.5),
        target=st.just("ball"),
    ),
    st.builds(
        closing,
        above=st.floats(-1, 1),
        probability_on=st.none() | st.floats(0.05, 0.95),
        probability_off=st.floats(0.05, 0.95),
        target=st.just("ball"),
    ),
    st.builds(direction, below=st.floats(-1, 1), deadband=st.floats(0, 0.2), target=st.just("ball")),
)
SIGHTS = st.builds(
    lambda distance_m, sigma_m, closing_mps, closing_sigma_mps, share, bearing_rad: track(
        distance_m,
        sigma_m,
        closing_mps=closing_mps,
        closing_sigma_mps=closing_sigma_mps,
        closing_cov_m2ps=share * sigma_m * closing_sigma_mps,
        bearing_rad=bearing_rad,
    ),
    st.floats(0.2, 5),
    st.floats(0, 1),
    st.floats(-2, 2),
    st.floats(0, 0.5),
    st.floats(-0.9, 0.9),
    st.floats(-1, 1),
)


@given(SIMPLE, SIGHTS)
def test_what_has_begun_does_not_end_while_nothing_moves(condition, sight):
    if holds(condition, sight):
        assert holds(condition, sight, is_active=True)


def transitions(condition, sights):
    """Count how often a condition begins and ends over some sights, without delays."""
    is_active, count = False, 0
    for sight in sights:
        value = holds(condition, sight, is_active=is_active)
        if value is not None and value is not is_active:
            is_active, count = value, count + 1
    return count


@given(
    st.lists(st.tuples(st.floats(0.8, 1.3), st.floats(0.001, 0.1)), max_size=40),
    st.floats(0, 4),
    st.floats(0, 4),
    st.sampled_from([None, 0.5, 0.8]),
)
def test_a_wider_band_never_means_more_transitions(sights, one, other, probability):
    tracks = [track(distance_m, sigma_m) for distance_m, sigma_m in sights]
    narrow, wide = (
        transitions(replace(NEAR, probability_on=probability, deadband_sigmas=sigmas), tracks)
        for sigmas in sorted((one, other))
    )
    assert wide <= narrow
