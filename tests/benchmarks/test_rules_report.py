"""The report of rules counts right, and our alarms reach what they are to reach."""

from __future__ import annotations

import math

import numpy as np
import pytest

# The report of rules says which goals are met.


def test_a_report_says_which_goals_are_met():
    import rules_report
    from part import Part

    facts = {"leap late 10 Hz": 0.1, "leap late 15 Hz": 0.1, "rules late 2 m": 0.3, "rules late 8 m": 0.1}
    text = rules_report.report([Part(title="Rules on noise", text="…", facts=facts)])
    lines = {line.split(" | ")[0]: line for line in text.splitlines() if line.startswith("| ")}
    assert lines["| a leap, 10 / 15 frames a second: how late"].endswith("| 0.100 s / 0.100 s | yes |")
    assert lines["| coming at 2 m/s: how late, on average"].endswith("| 0.300 s / 0.100 s | **no** |")
    assert "not measured" in text


# The simulation of rules on noise counts right, and our alarms reach what they are to reach.


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


# The benchmarks of following and of false raises count right, and what they are to reach is reached in small.


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


# A safety rule about speed stops for what is too fast, and hardly ever for what is not.

SEED = 7


@pytest.mark.long
def test_a_target_below_the_limit_hardly_ever_stops_the_robot_and_a_fast_one_is_not_found_much_later():
    import closing_speeds
    from closing_speeds import BEFORE, DEFAULT

    plan, names = closing_speeds.rules()
    ball = closing_speeds.NOISES[1]
    after_s = {
        speed_mps: [
            closing_speeds.stops_after_s(plan, speed_mps, ball, np.random.default_rng([SEED, run]))
            for run in range(runs)
        ]
        for speed_mps, runs in ((0.7, 60), (2.0, 20))
    }
    rule_of = {what: name for name, what in names.items()}
    stopped = {what: sum(np.isfinite(each[rule_of[what]]) for each in after_s[0.7]) for what in rule_of}
    assert stopped[DEFAULT] <= 4 < stopped[BEFORE]
    late_s = {what: np.median([each[rule_of[what]] for each in after_s[2.0]]) for what in rule_of}
    assert late_s[DEFAULT] - late_s[BEFORE] < 0.1


def test_lateness_counts_from_the_moment_in_which_the_limit_is_passed():
    from closing_speeds import distances, late_s

    times_s = np.array([0.9, 1.1, 1.2, 1.4, 2.4])
    moved_m = 4.0 - distances(2.0, times_s, 1.0)
    assert np.allclose(moved_m, [0.0, 0.025, 0.1, 0.4, 2.4])
    assert np.allclose(late_s(np.array([0.1, 0.2, 0.5])), [0.0, 0.0, 0.3])
