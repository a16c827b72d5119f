"""Settings of alarms, proposed from recordings."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.config.loader import load_configuration
from stadimeter.core.rule import OnDelay
from stadimeter.errors import ConfigError, JournalError
from stadimeter.workbench.replay.replay import read_recording
from stadimeter.workbench.tuning import candidates as tuning_candidates
from stadimeter.workbench.tuning import proposing as tuning
from stadimeter.workbench.tuning.candidates import Rate, Settings, candidate_beginnings, rule_to_tune
from stadimeter.workbench.tuning.noise import noise_of, series_of, stretches_of
from stadimeter.workbench.tuning.proposing import Beginning, Ending, choose_beginning, choose_ending, tune
from stadimeter.workbench.tuning.trials import (
    Transition,
    clearance_of,
    distance_at,
    end_latency_s,
    quiet_frames,
    raise_latency_s,
    raises_apart,
    truth_of,
)
from support.noisy_journal import KnownNoise, write_noisy_journal

CONFIGURATION = """
[camera]
driver = "simulated"
[camera.model]
width_px = 640
height_px = 480
fx_px = 1000.0
fy_px = 1000.0
cx_px = 319.5
cy_px = 239.5
[targets.ball]
detector = "ideal"
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
[rules.near]
when = { below = "2 m" }
[rules.far]
when = { above = "4 m" }
[rules.there]
when = { between = ["1 m", "5 m"] }
[rules.gone]
when = { lost = true }
[rules.danger]
severity = "safety"
when = { below = "2 m" }
"""


@pytest.fixture
def quick(monkeypatch):
    """Try less than for a user: what comes of it is less sure, and as well judged."""
    monkeypatch.setattr(tuning, "FRAMES_A_CLEARANCE", 500)
    monkeypatch.setattr(tuning_candidates, "PROBABILITIES", (0.5, 0.7, 0.9, 0.99))
    monkeypatch.setattr(tuning_candidates, "OFF_DELAYS_S", (0.0, 1.0))
    monkeypatch.setattr(tuning, "CROSSINGS", 8)
    monkeypatch.setattr(tuning, "HOVER_FRAMES", 800)


@pytest.fixture
def configuration(tmp_path):
    path = tmp_path / "rules.toml"
    path.write_text(CONFIGURATION)
    return load_configuration(path)


USUAL = KnownNoise()


def seen(folder: Path, where_m, noise=USUAL, **how):
    return series_of(
        read_recording(write_noisy_journal(folder / "run.jsonl", where_m, noise, **how)), "ball", "distance"
    )


@pytest.mark.long
def test_the_noise_of_a_recording_is_found_whatever_it_states(tmp_path):
    noise = KnownNoise(per_m2=0.012, stated_per_m2=0.006, correlation=0.6, gross=0.02, missing=0.1)
    found = noise_of([seen(tmp_path, lambda _: 2.0, noise, seconds=300)])
    assert found.ratio == pytest.approx(2.0, rel=0.07)
    assert found.true_m(2.0) == pytest.approx(0.048, rel=0.07)
    assert found.correlation == pytest.approx(0.6, abs=0.12)
    assert found.gross == pytest.approx(0.02, abs=0.008)
    assert found.missing == pytest.approx(0.1, abs=0.03)
    assert found.frame_s == pytest.approx(1 / 15)


def test_a_target_that_moves_steadily_is_no_noise(tmp_path):
    found = noise_of([seen(tmp_path, lambda at_s: 2.0 + 0.05 * at_s, seconds=60)])
    assert found.ratio == pytest.approx(1.0, rel=0.2)


def test_stretches_in_which_it_is_waved_about_are_left_out(tmp_path):
    def where_m(at_s):
        return 2.0 + (0.4 * np.sin(4 * at_s) if at_s > 60 else 0.0)

    series = seen(tmp_path, where_m, seconds=90)
    found = noise_of([series])
    assert len(found.calm) < len(stretches_of(series))
    assert found.ratio == pytest.approx(1.0, rel=0.25)


def walks(at_s):
    """Stand, creep, turn and come, as at a door: half of the time in motion, and never for 5 s without a change."""
    times_s, places_m = zip(
        (0, 3), (2, 3), (5, 2.05), (7, 1.98), (13, 2.01), (15, 0.8), (20, 0.8), (23, 3), strict=True
    )
    return float(np.interp(at_s % 23, times_s, places_m))


@pytest.mark.long
@pytest.mark.parametrize("noise", [KnownNoise(), KnownNoise(per_m2=0.001, stated_per_m2=0.001, correlation=0.0)])
def test_a_target_in_motion_has_no_outliers_and_no_more_noise_than_one_at_rest(tmp_path, noise):
    found = noise_of([seen(tmp_path, walks, noise, seconds=300)])
    assert found.gross < 0.005
    assert found.ratio == pytest.approx(1.0, abs=0.25)


def test_a_target_that_sways_all_the_time_tells_nothing_of_noise(tmp_path):
    with pytest.raises(JournalError, match=r"stood still, or moved steadily, for \d+ s .* at least 20 s"):
        noise_of([seen(tmp_path, lambda at_s: 2.5 + 0.4 * np.sin(1.3 * at_s), seconds=120)])


@pytest.mark.long
def test_outliers_of_a_target_at_rest_are_still_found(tmp_path):
    noise = KnownNoise(correlation=0.8, gross=0.1)
    found = noise_of([seen(tmp_path, lambda _: 2.0, noise, seconds=200, frames_per_s=30)])
    assert found.gross == pytest.approx(0.1, abs=0.02)
    assert found.calm_s > 180


def test_a_recording_without_a_calm_moment_is_refused(tmp_path):
    with pytest.raises(JournalError, match=r"stood still, or moved steadily, for 10 s .* at least 20 s"):
        noise_of([seen(tmp_path, lambda _: 2.0, seconds=14)])


def test_a_recording_of_another_target_says_which_it_has(tmp_path):
    with pytest.raises(JournalError, match=r"watches 'ball', which .* its targets are: cup"):
        seen(tmp_path, lambda _: 2.0, seconds=2, target="cup")


def test_a_pause_in_a_recording_is_no_stretch(tmp_path):
    series = seen(tmp_path, lambda _: 2.0, seconds=40)
    late = series.times_s > 20
    paused = replace(series, times_s=series.times_s + 100.0 * late)
    assert all(stretch.duration_s < 6 for stretch in stretches_of(paused))


def test_places_and_clearances_are_the_same_thing_on_both_sides_of_a_limit(tmp_path, configuration):
    noise = noise_of([seen(tmp_path, lambda _: 3.0, seconds=60)])
    for name in ("near", "far"):
        tuned = rule_to_tune(configuration, name)
        for clearance in (-1.5, 0.0, 0.5, 3.0):
            at_m = distance_at(tuned, noise, clearance)
            assert clearance_of(tuned, noise, at_m) == pytest.approx(clearance)
    assert distance_at(rule_to_tune(configuration, "near"), noise, 1000.0) is None


def test_a_target_that_truly_comes_is_no_quiet_time_nor_is_a_marked_event(tmp_path, configuration):
    tuned = rule_to_tune(configuration, "near")
    series = seen(tmp_path, lambda at_s: 1.5 if 60 < at_s < 70 else 2.5, seconds=120)
    noise = noise_of([series])
    quiet = quiet_frames(series, tuned, noise, [])
    assert not quiet[(series.times_s > 61) & (series.times_s < 69)].any()
    assert quiet[series.times_s < 55].all()
    marked = quiet_frames(series, tuned, noise, [30.0])
    assert not marked[(series.times_s > 26) & (series.times_s < 34)].any()


def test_where_a_target_was_is_not_known_when_it_was_not_seen_at_all(tmp_path):
    series = seen(tmp_path, lambda _: 2.0, seconds=20)
    gone = (series.times_s > 5) & (series.times_s < 10)
    truth_m = truth_of(replace(series, figures_m=np.where(gone, np.nan, series.figures_m)))
    assert np.isnan(truth_m[(series.times_s > 6) & (series.times_s < 9)]).all()
    assert np.isfinite(truth_m[~gone]).all()


@pytest.mark.long
def test_a_target_that_stands_close_gets_stricter_settings_than_one_far_away(tmp_path, configuration, quick):
    tuned = rule_to_tune(configuration, "near")
    close, away = (
        tune(
            tuned,
            configuration.plan,
            [seen(tmp_path, lambda _, at_m=at_m: at_m, seconds=120)],
            wanted_a_day=1,
            speed_mps=2,
        )
        for at_m in (2.1, 3.0)
    )
    assert away.is_reached
    assert away.begin.late_s < close.begin.late_s
    assert away.begin.rate.a_day < 0.01
    assert away.is_extrapolated
    assert close.begin.rate.a_day > away.begin.rate.a_day
    assert close.end.flaps_a_minute <= tuning.FLAPS_A_MINUTE


@pytest.mark.long
def test_what_ten_minutes_support_is_never_called_once_a_day(tmp_path, configuration, quick):
    proposal = tune(
        rule_to_tune(configuration, "near"),
        configuration.plan,
        [seen(tmp_path, lambda _: 3.0, seconds=120)],
        wanted_a_day=1,
        speed_mps=2,
    )
    assert proposal.begin.recorded_raises == 0
    assert proposal.supported_a_day == pytest.approx(3.0 / 120 * 86400, rel=0.03)
    assert not proposal.is_supported


@pytest.mark.long
def test_the_same_seed_gives_the_same_proposal(tmp_path, configuration, quick):
    series = seen(tmp_path, lambda _: 2.15, seconds=60)
    tuned = rule_to_tune(configuration, "near")
    first, again = (tune(tuned, configuration.plan, [series], wanted_a_day=10, speed_mps=2, seed=3) for _ in range(2))
    assert first.beginnings == again.beginnings
    assert first.endings == again.endings


@pytest.mark.long
def test_an_alarm_on_a_target_that_goes_away_is_tuned_too(tmp_path, configuration, quick):
    proposal = tune(
        rule_to_tune(configuration, "far"),
        configuration.plan,
        [seen(tmp_path, lambda _: 3.0, seconds=60)],
        wanted_a_day=1,
        speed_mps=1,
    )
    assert proposal.is_reached
    assert proposal.begin.late_s < 0.4


def test_a_target_that_stands_where_the_alarm_is_right_cannot_tell_of_false_alarms(tmp_path, configuration, quick):
    with pytest.raises(JournalError, match=r"nearer than 2\.00 m, where an alarm of 'near' is a true one"):
        tune(
            rule_to_tune(configuration, "near"),
            configuration.plan,
            [seen(tmp_path, lambda _: 1.0, seconds=40)],
            wanted_a_day=1,
            speed_mps=2,
        )


@pytest.mark.long
def test_raises_that_happened_in_the_recording_count_against_a_setting(tmp_path, configuration, quick):
    def where_m(at_s):
        return 1.97 if int(at_s) % 20 == 10 else 2.2  # closer for a second, but not clearly across

    noise = KnownNoise(per_m2=0.012, stated_per_m2=0.002)
    proposal = tune(
        rule_to_tune(configuration, "near"),
        configuration.plan,
        [seen(tmp_path, where_m, noise, seconds=200)],
        wanted_a_day=1,
        speed_mps=2,
    )
    assert proposal.beginnings[0].recorded_raises > 0
    assert proposal.supported_a_day > 3 / 200 * 86400


def test_of_two_limits_the_one_nearer_to_the_target_is_tuned(configuration):
    assert (rule_to_tune(configuration, "there", 0.8).threshold_m, rule_to_tune(configuration, "there", 0.8).side) == (
        1.0,
        -1,
    )
    assert (rule_to_tune(configuration, "there", 6.0).threshold_m, rule_to_tune(configuration, "there", 6.0).side) == (
        5.0,
        1,
    )


def test_a_safety_alarm_is_never_told_to_wait(configuration):
    tried = candidate_beginnings(rule_to_tune(configuration, "danger"))
    assert {settings.on_delay for settings in tried} == {OnDelay()}


def test_a_rule_that_is_not_there_or_not_on_a_distance_is_refused(configuration):
    with pytest.raises(ConfigError, match=r"no rule 'neer'.*did you mean 'near'"):
        rule_to_tune(configuration, "neer")
    with pytest.raises(ConfigError, match=r"'gone' is none that a distance alone raises"):
        rule_to_tune(configuration, "gone")


SETTINGS = Settings(probability=0.8, on_delay=OnDelay(), deadband_sigmas=3.0, off_delay_s=1.0)


def beginning(a_day, late, recorded=0):
    rate = Rate(a_day=a_day, at_most_a_day=2 * a_day)
    return Beginning(settings=SETTINGS, rate=rate, recorded_raises=recorded, late_s=late, late_p95_s=late)


def test_the_earliest_that_is_seldom_enough_raised_is_chosen():
    tried = [beginning(50, 0.03), beginning(0.9, 0.05), beginning(0.01, 0.2)]
    assert choose_beginning(tried, 1.0, 600) is tried[1]
    assert choose_beginning(tried, 100, 600) is tried[0]
    assert choose_beginning(tried, 0.001, 600) is tried[2]


def test_what_was_raised_in_the_recording_is_not_chosen_whatever_is_expected_of_it():
    tried = [beginning(0.1, 0.03, recorded=2), beginning(0.9, 0.05)]
    assert choose_beginning(tried, 1.0, 600) is tried[1]


def test_the_earliest_ending_that_does_not_flap_is_chosen():
    tried = [
        Ending(settings=SETTINGS, flaps_a_minute=flaps, ends_after_s=after_s)
        for flaps, after_s in ((3.0, 0.1), (0.0, 0.5), (0.0, 2.0))
    ]
    assert choose_ending(tried) is tried[1]
    assert choose_ending(tried[:1]) is tried[0]


def transitions(*changes):
    return [Transition(at_s=at_s, is_raise=is_raise) for at_s, is_raise in changes]


def test_lateness_counts_from_the_crossing_and_early_is_not_late():
    assert raise_latency_s(transitions((0.2, True))) == 0.2
    assert raise_latency_s(transitions((-0.2, True))) == 0.0
    assert raise_latency_s(transitions((-0.2, True), (-0.1, False), (0.3, True))) == 0.3
    assert raise_latency_s(transitions((-0.2, True), (0.1, False))) == 0.0
    assert raise_latency_s([]) == float("inf")


def test_an_alarm_is_over_when_it_is_over_for_good():
    assert end_latency_s(transitions((-2, True), (0.4, False))) == 0.4
    assert end_latency_s(transitions((-2, True), (-1, False))) == 0.0
    assert end_latency_s(transitions((-2, True))) == float("inf")


def test_raises_in_quick_succession_are_one():
    assert raises_apart(transitions((0, True), (0.1, False), (0.2, True), (5, False), (6, True)), 1.0) == 2
