"""The command ``tune``."""

import json

import pytest
from typer.testing import CliRunner

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.journal import JournalWriter
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.cli.main import app
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.observation import Observation
from stadimeter.core.plan import Plan
from stadimeter.workbench.tuning import candidates as tuning_candidates
from stadimeter.workbench.tuning import proposing as tuning
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
when = { below = "2 m", deadband = "5 cm" }
[rules.gone]
when = { lost = true }
"""


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "rules.toml"
    path.write_text(CONFIGURATION)
    return path


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(tuning, "FRAMES_A_CLEARANCE", 300)
    monkeypatch.setattr(tuning, "CLEARANCES", (-1.5, 0.0, 1.0, 2.0, 3.0, 3.5))
    monkeypatch.setattr(tuning_candidates, "PROBABILITIES", (0.5, 0.7, 0.9, 0.99))
    monkeypatch.setattr(tuning_candidates, "OFF_DELAYS_S", (0.0, 1.0))
    monkeypatch.setattr(tuning, "CROSSINGS", 4)
    monkeypatch.setattr(tuning, "HOVER_FRAMES", 300)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_noisy_journal(tmp_path_factory.mktemp("tune") / "quiet.jsonl", lambda _: 3.0, KnownNoise(), seconds=40)


def run(*arguments):
    return CliRunner().invoke(app, ["tune", *(str(each) for each in arguments)])


@pytest.mark.long
def test_where_no_setting_keeps_to_what_was_asked_for_none_is_proposed(config, tmp_path, quick):
    hovering = write_noisy_journal(tmp_path / "hovering.jsonl", lambda _: 2.0, KnownNoise(), seconds=40)
    done = run("near", hovering, "--config", config)
    assert done.exit_code == 1
    assert "so none is proposed" in done.output
    assert "within one standard deviation of the threshold" in done.output
    assert "For [rules.near]" not in done.output
    assert "→" not in done.output
    assert json.loads(run("near", hovering, "--config", config, "--json").stdout)["toml"] == []


@pytest.mark.long
def test_the_lines_for_the_rule_and_what_they_rest_on_are_printed(config, recording, quick):
    done = run("near", recording, "--config", config)
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    begin = lines.index("For [rules.near]:")
    assert lines[begin + 1].startswith('when = { below = "2 m", probability = 0.5, deadband_sigmas = ')
    assert lines[begin + 1].endswith(', deadband = "0.05 m" }')
    assert lines[begin + 2] == 'on_delay = "0 s"'
    assert lines[begin + 3].startswith('off_delay = "')
    assert "The recordings alone support no better than" in done.output
    assert "For 1 a day, record 72 h without a true alarm." in done.output
    assert "the figures are extrapolated" in done.output
    assert "Noise: ±" in done.output


@pytest.mark.long
def test_what_is_proposed_can_be_put_into_the_rule(config, recording, quick):
    from stadimeter.config.loader import load_configuration

    told = json.loads(run("near", recording, "--config", config, "--json").stdout)
    when, *others = told["toml"]
    changed = CONFIGURATION.replace('when = { below = "2 m", deadband = "5 cm" }', "\n".join((when, *others)))
    config.write_text(changed)
    (near, _) = load_configuration(config).plan.rules
    assert near.condition.probability_on == told["proposed"]["probability"]
    assert near.condition.deadband_sigmas == told["proposed"]["deadband_sigmas"]
    assert near.condition.deadband_m == pytest.approx(0.05)
    assert near.off_delay_s == told["proposed"]["off_delay_s"]


@pytest.mark.long
def test_a_target_that_is_noisier_than_stated_gets_a_noise_factor_proposed(config, recording, tmp_path, quick):
    from stadimeter.config.loader import load_configuration

    assert "noise_factor" not in run("near", recording, "--config", config).output
    noise = KnownNoise(stated_per_m2=0.002)
    noisy = write_noisy_journal(tmp_path / "noisy.jsonl", lambda _: 3.0, noise, seconds=60)
    lines = run("near", noisy, "--config", config).output.splitlines()
    (proposed,) = (line for line in lines if line.startswith("noise_factor = "))
    config.write_text(f"{CONFIGURATION}[tracking]\n{proposed}\n")
    assert load_configuration(config).plan.tracking.noise_factor == pytest.approx(3.0, abs=0.6)
    assert not any(
        line.startswith("noise_factor") for line in run("near", noisy, "--config", config).output.splitlines()
    )


@pytest.mark.long
def test_as_json_all_that_was_tried_is_told(config, recording, quick):
    done = run("near", recording, "--config", config, "--json", "--closing-speed", "1 m/s")
    told = json.loads(done.stdout)
    assert told["closing_speed_mps"] == 1.0
    assert told["reached"] is True
    assert told["supported_by_recordings"] is False
    assert 20 < len(told["beginnings"]) + len(told["endings"]) <= 60
    assert told["beginnings"][0]["probability"] == 0.7, "the rule's own settings come first"


@pytest.mark.long
def test_when_nothing_is_seldom_enough_the_best_is_printed_and_the_exit_code_says_so(config, tmp_path, quick):
    close = write_noisy_journal(tmp_path / "close.jsonl", lambda _: 2.02, KnownNoise(), seconds=40)
    done = run("near", close, "--config", config, "--false-alarms-per-day", "0.01")
    assert done.exit_code == 1
    assert "The best: " in done.output


def test_an_event_after_the_end_of_the_recording_is_refused(config, recording):
    done = run("near", recording, "--config", config, "--event", "2 h")
    assert done.exit_code == 2
    assert "is after the end of the recording" in " ".join(done.output.replace("│", " ").split())


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["neer"], "did you mean 'near'?"),
        (["gone"], "only such alarms can be tuned"),
        (["near", "--closing-speed", "2"], "has no unit"),
        (["near", "--closing-speed", "0 m/s"], "not above zero"),
        (["near", "--event", "soon"], "not a number with a unit"),
    ],
)
def test_what_cannot_be_tuned_is_said(config, recording, quick, arguments, says):
    done = run(arguments[0], recording, "--config", config, *arguments[1:])
    assert done.exit_code == 2
    assert says in done.output


def test_events_in_one_of_several_recordings_are_refused(config, recording, quick):
    done = run("near", recording, recording, "--config", config, "--event", "3 s")
    assert done.exit_code == 2
    assert "not clear in which" in " ".join(done.output.split())


def test_recordings_that_tell_nothing_are_refused(config, tmp_path, quick):
    cup = write_noisy_journal(tmp_path / "cup.jsonl", lambda _: 3.0, KnownNoise(), seconds=2, target="cup")
    assert "its targets are: cup" in run("near", cup, "--config", config).output
    short = write_noisy_journal(tmp_path / "short.jsonl", lambda _: 3.0, KnownNoise(), seconds=7)
    assert "at least 20 s are needed" in run("near", short, "--config", config).output
    (tmp_path / "none.txt").write_text("hello")
    done = run("near", tmp_path / "none.txt", "--config", config)
    assert (done.exit_code, "not a journal" in done.output) == (2, True)


def test_a_recording_without_a_frame_is_refused(config, tmp_path, quick):
    writer = JournalWriter(tmp_path / "dark.jsonl", RecordedConfiguration(text=""))
    state = initial_state(Plan(targets=("ball",)))
    observation = Observation(now_s=1.0, camera_fault="no camera")
    _, decision = decide(state, observation)
    writer.write(CycleRecord(observation=observation, applied=(), timings_s={}, decision=decision))
    writer.close()
    done = run("near", tmp_path / "dark.jsonl", "--config", config)
    assert done.exit_code == 2
    assert "no frame was recorded" in done.output


@pytest.mark.long
def test_without_a_configuration_it_takes_that_of_the_recording(config, recording, quick):
    head, _, rest = recording.read_bytes().partition(b"\n")
    header = json.loads(head) | {"configuration": CONFIGURATION}
    recording.write_bytes(json.dumps(header, separators=(",", ":")).encode() + b"\n" + rest)
    named = json.loads(run("near", recording, "--config", config, "--json").stdout)
    found = run("near", recording, "--json")
    assert found.exit_code == 0, found.output
    assert json.loads(found.stdout) == named
