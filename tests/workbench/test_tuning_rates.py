"""What counts say of rare events."""

import math

import numpy as np
import pytest

from stadimeter.workbench.tuning.candidates import Count, at_most, rate_at, slope_of

HOUR_S = 3600.0


def counts_of(most, shift=0.0, points=(-1.0, 0.0, 1.0, 2.0, 3.0)):
    """Return what is counted in an hour of something that falls off to a twentieth with each step."""
    return [
        Count(clearance=at, raises=min(most, round(most * 20 ** -(at + shift))), duration_s=HOUR_S) for at in points
    ]


def test_the_most_that_a_count_allows_is_that_of_the_poisson_distribution():
    for count, expected in [(0, 2.996), (1, 4.744), (5, 10.51), (50, 63.29)]:
        assert at_most(count) == pytest.approx(expected, rel=0.01)


def test_a_rate_where_nothing_could_be_counted_follows_the_slope():
    counts = counts_of(8000)
    slope = slope_of([counts])
    assert slope.per_sigma == pytest.approx(-math.log(20), rel=0.05)
    rate = rate_at(counts, slope, np.array([4.0]), None, np.random.default_rng(1))
    true_a_day = 8000 * 20**-4 * 24
    assert true_a_day / 2 < rate.a_day < true_a_day * 2
    assert rate.at_most_a_day >= rate.a_day


def test_the_further_away_the_target_stands_the_more_seldom_it_is_raised():
    counts = counts_of(500)
    slope = slope_of([counts])
    rates = [rate_at(counts, slope, np.array([at]), None, np.random.default_rng(1)).a_day for at in (0, 1, 2, 4, 8, 16)]
    assert rates == sorted(rates, reverse=True)


def test_nowhere_is_it_raised_more_often_than_where_it_was_raised_most_often():
    counts = counts_of(500)
    rate = rate_at(counts, slope_of([counts]), np.array([0.0]), None, np.random.default_rng(1))
    assert rate.a_day <= 500 * 24 * (1 + 1e-9)


def test_gross_errors_that_reach_the_target_where_it_stands_count():
    counts = counts_of(500)
    far = Count(clearance=12.0, raises=4, duration_s=HOUR_S)
    rate = rate_at(counts, slope_of([counts]), np.array([12.0]), far, np.random.default_rng(1))
    assert rate.a_day == pytest.approx(96)
    assert rate.at_most_a_day == pytest.approx(at_most(4) * 24)


def test_settings_that_were_never_raised_have_a_rate_too():
    never = [Count(clearance=at, raises=0, duration_s=HOUR_S) for at in (0.0, 1.0, 2.0)]
    slope = slope_of([counts_of(500), never])
    rate = rate_at(never, slope, np.array([1.0, 3.0]), None, np.random.default_rng(1))
    assert 0 < rate.a_day < rate_at(counts_of(500), slope, np.array([1.0, 3.0]), None, np.random.default_rng(1)).a_day
