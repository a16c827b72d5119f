"""The benchmarks of following and of false raises count right, and what they are to reach is reached in small."""

from __future__ import annotations

import numpy as np
import pytest


def test_the_kinds_of_noise_that_are_judged_have_the_standard_deviation_that_is_stated():
    from false_raises import KINDS, WIDER

    for kind, heights in KINDS.items():
        spread = np.std(heights(400_000, np.random.default_rng(5)))
        assert spread == pytest.approx(1.45 if kind == WIDER else 1.0, rel=0.1)


def test_the_interval_of_a_rate_is_that_of_a_poisson_variable():
    from false_raises import interval

    low, high = interval(18, 200.0)
    assert (low, high) == pytest.approx((0.053, 0.142), abs=0.002)
    assert interval(0, 200.0) == pytest.approx((0.0, 0.0184), abs=0.0005)


@pytest.mark.parametrize("name", ["rest", "sway", "walk", "approach"])
def test_the_intervals_of_a_target_that_moves_hold_as_often_as_they_say(name):
    from following import WAYS, errors

    from support.scenes import draw

    _, sigmas, _ = errors(WAYS[name], 4.0, 20, draw.TUNING_SEEDS.start)
    assert 0.58 <= np.mean(np.abs(sigmas) < 1) <= 0.78
    assert 0.83 <= np.mean(np.abs(sigmas) < 1.645) <= 0.96


def test_a_leap_is_believed_within_a_fifth_of_a_second():
    from following import late_s

    assert late_s(15.0, 20, 1) <= 0.14
    assert late_s(10.0, 20, 1) <= 0.2 + 1e-9
