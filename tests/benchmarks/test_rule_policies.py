"""The simulation of rules on noise counts right, and our alarms reach what they are to reach."""

from __future__ import annotations

import math

import numpy as np
import pytest


def turns(*changes):
    from rule_policies import Turn

    return [Turn(at_s=at_s, is_raise=is_raise) for at_s, is_raise in changes]


def test_the_noise_is_that_of_the_box():
    from rule_policies import DROPOUTS, measure, sigma_m

    for at_m, expected_m in ((2.0, 0.024), (8.0, 0.384)):
        assert sigma_m(at_m) == pytest.approx(expected_m)
        seen_m = measure(np.full(60_000, at_m), np.random.default_rng(1))
        there = seen_m[np.isfinite(seen_m)]
        assert 1.4826 * np.median(np.abs(there - np.median(there))) == pytest.approx(expected_m, rel=0.05)
        assert 1 - len(there) / len(seen_m) == pytest.approx(DROPOUTS, rel=0.1)


def test_lateness_counts_from_the_crossing_and_early_is_not_late():
    from rule_policies import late_s

    assert late_s(turns((3.1, True)), 3.0) == pytest.approx(0.1)
    assert late_s(turns((2.9, True)), 3.0) == 0.0
    assert late_s(turns((2.9, True), (2.95, False), (3.2, True)), 3.0) == pytest.approx(0.2)
    assert late_s([], 3.0) == math.inf


def test_the_policies_of_others_do_what_is_said_of_them():
    from rule_policies import held_for, plain

    seen_m = np.array([3.0, 1.9, math.nan, 2.05, 1.9, 1.9, 1.9])
    times_s = np.arange(7) / 4
    assert list(plain(seen_m, times_s, 2.0)) == turns((0.25, True), (0.75, False), (1.0, True))
    assert list(plain(seen_m, times_s, 2.0, 0.1)) == turns((0.25, True))
    assert list(held_for(seen_m, times_s, 2.0, 0.5)) == turns((1.5, True))


@pytest.mark.long
@pytest.mark.timeout(400)
def test_an_alarm_as_it_comes_does_not_flap_is_hardly_raised_for_nothing_and_is_not_late():
    from rule_policies import DEFAULT, SAFETY, simulate

    from support.scenes import draw

    scores = simulate(draw.REPORT_SEEDS.start)
    for score in scores[DEFAULT].values():
        assert score.turns_a_minute <= 1.0
        assert score.false_raises_a_minute <= 0.05
        assert score.mean_late_s <= 0.11
    for score in scores[SAFETY].values():
        assert score.turns_a_minute <= 1.0
        assert score.mean_late_s <= 0.11
