"""Whether a condition holds."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.plan import DistanceCondition, PresenceCondition
from stadimeter.core.rules.conditions import holds, in_words, probability_between, widened_limits
from stadimeter.core.track import Track, TrackStatus


def track(distance_m, sigma_m=0.02, status=TrackStatus.TRACKING, depth_m=None):
    return Track(
        target="ball",
        status=status,
        distance_m=distance_m,
        depth_m=distance_m if depth_m is None else depth_m,
        sigma_m=sigma_m,
    )


NEAR = DistanceCondition(below_m=1.0, probability_on=0.8)


def test_it_begins_when_it_is_likely_enough():
    assert holds(NEAR, track(0.97), is_active=False) is True
    assert holds(NEAR, track(0.99), is_active=False) is False  # P = 0.69
    assert holds(NEAR, track(1.03), is_active=False) is False


def test_once_begun_it_lasts_until_the_deadband_is_left():
    assert holds(NEAR, track(1.05), is_active=True) is True
    assert holds(NEAR, track(1.08), is_active=True) is False


def test_the_reason_names_the_figures():
    assert in_words(NEAR, track(0.99), is_active=False) == "0.99 m ± 0.02, below 1.00 m: P 0.69, begins at 0.80"


@pytest.mark.parametrize("status", [TrackStatus.LOST, TrackStatus.SEARCHING])
@pytest.mark.parametrize("is_active", [True, False])
def test_without_the_target_nothing_is_known(status, is_active):
    assert holds(NEAR, track(0.5, status=status), is_active=is_active) is None


@pytest.mark.parametrize("broken", [math.nan, math.inf, None])
def test_a_figure_that_is_not_finite_is_not_known_either(broken):
    assert holds(NEAR, track(broken), is_active=False) is None
    assert holds(NEAR, track(0.5, sigma_m=broken), is_active=False) is None


def test_between_needs_both_limits():
    between = DistanceCondition(above_m=1.0, below_m=2.0)
    assert [holds(between, track(d), is_active=False) for d in (0.9, 1.5, 2.1)] == [False, True, False]


def test_depth_can_be_meant_instead_of_distance():
    by_depth = DistanceCondition(below_m=1.0, quantity="depth")
    assert holds(by_depth, track(1.2, depth_m=0.9), is_active=False) is True


def test_plain_comparison_is_there_for_who_wants_it():
    plain = DistanceCondition(below_m=1.0, probability_on=None, deadband_sigmas=0.0, deadband_m=0.1)
    assert holds(plain, track(0.999, sigma_m=0.5), is_active=False) is True
    assert holds(plain, track(1.09, sigma_m=0.5), is_active=True) is True
    assert holds(plain, track(1.11, sigma_m=0.5), is_active=True) is False


def test_the_deadband_grows_with_the_standard_deviation():
    far = DistanceCondition(below_m=8.0)
    _, near_limit = widened_limits(NEAR, 1.0, 0.01)
    _, far_limit = widened_limits(far, 8.0, 0.64)
    assert near_limit == pytest.approx(1.03)
    assert far_limit == pytest.approx(9.92)


def test_presence_is_always_known():
    seen, lost = PresenceCondition(seen=True), PresenceCondition(seen=False)
    for status in TrackStatus:
        is_seen = status in {TrackStatus.TRACKING, TrackStatus.COASTING}
        assert holds(seen, track(1.0, status=status), is_active=False) is is_seen
        assert holds(lost, track(1.0, status=status), is_active=False) is not is_seen


@given(st.floats(0.1, 10), st.floats(0.1, 10), st.floats(0.1, 10), st.floats(0, 3))
def test_probabilities_are_probabilities(a, b, value, sigma):
    low, high = sorted((a, b))
    likely = probability_between(low, high, value, sigma)
    assert -1e-12 <= likely <= 1
    assert probability_between(-math.inf, math.inf, value, sigma) == 1.0


@given(st.floats(0.2, 10), st.floats(0.001, 1))
def test_what_has_begun_does_not_end_at_the_same_distance(value, sigma):
    condition = DistanceCondition(below_m=5.0)
    if holds(condition, track(value, sigma), is_active=False):
        assert holds(condition, track(value, sigma), is_active=True)
