"""The command ``tune``."""

import json

import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.workbench.tuning import proposing as tuning
from stadimeter.workbench.tuning import proposing as tuning_candidates
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


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["neer"], "did you mean 'near'?"),
        (["gone"], "only such alarms can be tuned"),
        (["near", "--closing-speed", "2"], "has no unit"),
        (["near", "--event", "soon"], "not a number with a unit"),
    ],
)
def test_what_cannot_be_tuned_is_said(config, recording, quick, arguments, says):
    done = run(arguments[0], recording, "--config", config, *arguments[1:])
    assert done.exit_code == 2
    assert says in done.output
