"""Settings of alarms, proposed from recordings."""

from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.core.rule import OnDelay
from stadimeter.workbench.replay.replay import read_recording
from stadimeter.workbench.tuning import proposing as tuning
from stadimeter.workbench.tuning import proposing as tuning_candidates
from stadimeter.workbench.tuning.noise import noise_of, series_of
from stadimeter.workbench.tuning.proposing import candidate_beginnings, rule_to_tune, tune
from support.noisy_journal import KnownNoise, write_noisy_journal

CONFIGURATION = """
[camera]
driver = "simulated"
[camera.model]
width_px = 640
height_px = 480
fx_px = 1000.0
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


def test_a_safety_alarm_is_never_told_to_wait(configuration):
    tried = candidate_beginnings(rule_to_tune(configuration, "danger"))
    assert {settings.on_delay for settings in tried} == {OnDelay()}
