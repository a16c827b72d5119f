"""A rule that the camera and the target cannot serve is told before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.config.loader import load_configuration
from stadimeter.errors import Problem

EXAMPLES = Path(__file__).parents[2] / "config"
BALL_67_MM = """\
[camera]
driver = "opencv"
device = 0
model = {{ width_px = 640, height_px = 480, fx_px = 600.0, focal_relative_sigma = {sigma} }}

[targets.ball]
detector = "ball"
diameter = "6.7 cm"
hsv = "29,86,6:64,255,255"

[actuators.motor]
driver = "vibration-motor"
pin = 18

[rules.far]
actuator = "motor"
{rule}
"""


def warnings(folder: Path, rule: str, sigma: float = 0.01) -> tuple[Problem, ...]:
    file = folder / "rules.toml"
    file.write_text(BALL_67_MM.format(rule=rule, sigma=sigma), encoding="utf-8")
    return feasibility_warnings(load_configuration(file))


def test_a_rule_on_ten_metres_with_a_tennis_ball_is_told_its_four_pixels_and_what_helps(tmp_path):
    (small,) = warnings(tmp_path, 'when = { above = "10 m" }')
    assert "at 10.00 m (32.8 ft) 'ball' will be 4 px wide in a picture of 640x480" in small.message
    assert "3.0 times as large would do, or a limit within 3.35 m" in small.hint
    assert (small.key, small.line) == ("rules.far.when", 17)


def test_a_deadband_in_which_the_noise_leaves_no_end_is_told(tmp_path):
    (noisy,) = warnings(tmp_path, 'when = { above = "3 m", deadband_sigmas = 60 }')
    assert "at 3.00 m (9.8 ft) the distance differs by ± 0.03 m from frame to frame" in noisy.message
    assert "60 standard deviations, 1.83 m, an alarm may not end" in noisy.message


def test_a_scale_that_is_not_known_well_keeps_no_alarm_from_ending(tmp_path):
    assert warnings(tmp_path, 'when = { above = "1 m" }', sigma=0.2) == ()
    assert warnings(tmp_path, 'when = { below = "3 m" }', sigma=0.2) == ()


def test_limits_between_which_a_distance_is_never_likely_enough_to_be_are_told(tmp_path):
    (narrow,) = warnings(tmp_path, 'when = { between = ["1 m", "1.2 m"] }', sigma=0.1)
    assert "the distance is sure to ± 0.11 m only" in narrow.message
    assert "with a probability of 64% at most, and 70% is asked for: this may never begin" in narrow.message
    assert warnings(tmp_path, 'when = { between = ["1 m", "1.2 m"] }') == ()
    assert warnings(tmp_path, 'when = { between = ["1 m", "1.2 m"], probability = "none" }', sigma=0.1) == ()


@pytest.mark.parametrize("name", ["appliance", "follow-ball", "distance-alert", "demo"])
def test_the_examples_ask_for_nothing_that_cannot_be_done(name):
    assert feasibility_warnings(load_configuration(EXAMPLES / f"{name}.toml")) == ()
