"""What `check` says a run would lack on this computer: devices, pins, libraries, and frames often enough."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.this_computer import warnings_here
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import Problem
from support.simulated_run import LENS, SIMULATED_BALL

RULE = '[rules.near]\nactuator = "siren"\nwhen = { below = "1 m" }\n'
SIREN = '[actuators.siren]\ndriver = "relay"\npin = 17\n'


def loaded(tmp_path: Path, *parts: str) -> Configuration:
    path = tmp_path / "run.toml"
    path.write_text("\n".join(parts), encoding="utf-8")
    return load_configuration(path)


def lacking(tmp_path: Path, *parts: str) -> list[tuple[str, str, str]]:
    return [(each.code, each.key, each.message) for each in warnings_here(loaded(tmp_path, *parts))]


@pytest.fixture
def mock_pins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GPIOZERO_PIN_FACTORY", "mock")


def test_pins_of_another_library_than_ours_are_told_before_a_run(tmp_path, monkeypatch):
    monkeypatch.setenv("GPIOZERO_PIN_FACTORY", "pigpio")
    ((code, key, message),) = lacking(tmp_path, SIMULATED_BALL, SIREN, RULE, "[world]")
    assert (code, key) == ("driver-lacks", "actuators.siren")
    assert "GPIOZERO_PIN_FACTORY=pigpio" in message


def test_a_library_that_is_missing_comes_with_the_line_for_this_python(tmp_path, monkeypatch):
    monkeypatch.setattr("stadimeter.config.extras.find_spec", lambda _name: None)
    monkeypatch.setattr("stadimeter.config.extras.WITHOUT_LGPIO", (4, 0))
    monkeypatch.delenv("GPIOZERO_PIN_FACTORY", raising=False)
    phone = '[notifiers.phone]\ndriver = "apprise"\nurl_file = "phone.txt"\n'
    found = lacking(tmp_path, SIMULATED_BALL, SIREN, phone, RULE, 'notify = "phone"', "[world]")
    lacks = [message for code, _, message in found if code == "driver-lacks"]
    assert f"{sys.executable} -m pip install 'stadimeter[pi]'" in lacks[0]
    assert f"{sys.executable} -m pip install 'stadimeter[notify]'" in lacks[1]
    assert lacks[2].endswith(f"there is no file {tmp_path / 'phone.txt'}")


@pytest.mark.usefixtures("mock_pins")
def test_a_camera_and_a_serial_port_that_are_not_there_are_told(tmp_path):
    camera = f'[camera]\ndriver = "opencv"\ndevice = "{tmp_path / "video7"}"\n'
    model = "[camera.model]\nwidth_px = 640\nheight_px = 480\nfx_px = 600.0\n"
    target = '[targets.ball]\ndetector = "ball"\ndiameter = "7 cm"\nhsv = "29,86,6:64,255,255"\n'
    base = '[base]\ndriver = "ros-arduino-bridge"\nwheel_diameter = "6 cm"\nticks_per_turn = 100\n'
    base += 'track_width = "20 cm"\n'
    rule = '[rules.follow]\nactuator = "base"\nfollow = { distance = "1 m" }\n'
    found = lacking(tmp_path, camera, model, target, f'{base}port = "{tmp_path / "ttyUSB7"}"', rule)
    assert [key for _, key, _ in found] == ["camera", "base"]
    assert "there is no camera" in found[0][2]
    assert "there is no serial port" in found[1][2]
    _, port = os.openpty()
    found = lacking(tmp_path, camera, model, target, f'{base}port = "{os.ttyname(port)}"', rule)
    assert [key for _, key, _ in found] == ["camera"]


def test_what_a_run_refuses_for_want_of_a_camera_model_is_told(tmp_path):
    text = '[camera]\ndriver = "simulated"\n[targets.ball]\ndetector = "ideal"\n[world]\n'
    assert [code for code, _, _ in lacking(tmp_path, text)] == ["camera-model-missing"]


@pytest.mark.usefixtures("mock_pins")
def test_a_live_camera_too_slow_for_outputs_is_warned_of_until_the_hint_is_followed(tmp_path):
    camera = '[camera]\ndriver = "opencv"\ndevice = 0\nrate = "4 Hz"\n'
    model = "[camera.model]\nwidth_px = 640\nheight_px = 480\nfx_px = 600.0\n"
    target = '[targets.ball]\ndetector = "ball"\ndiameter = "20 cm"\nhsv = "29,86,6:64,255,255"\n'
    before = feasibility_warnings(loaded(tmp_path, camera, model, target, SIREN, RULE))
    (warning,) = [each for each in before if each.code == "rate-too-low"]
    age = re.findall(r'max_frame_age = ("[^"]+")', warning.hint)[0]
    after = loaded(tmp_path, camera, model, target, f"{SIREN}lease = {age}", RULE, f"[safety]\nmax_frame_age = {age}")
    assert "rate-too-low" not in [each.code for each in (*feasibility_warnings(after), *after.warnings)]
    simulated = loaded(tmp_path, SIMULATED_BALL.replace("30 Hz", "4 Hz"), SIREN, RULE, "[world]")
    assert "rate-too-low" not in [each.code for each in feasibility_warnings(simulated)]


BALL = '[targets.ball]\ndetector = "ball"\ndiameter = "20 cm"\nhsv = "29,86,6:64,255,255"\n'
NEAR = '[rules.near]\nwhen = { below = "1 m" }\n'


def test_each_file_that_is_named_and_not_there_is_found_with_its_key(tmp_path):
    camera = f'[camera]\ndriver = "video"\npath = "gone.mp4"\n{LENS}'
    broker = '[messenger]\ndriver = "mqtt"\nusername = "zoe"\npassword_file = "secret.txt"\n'
    page = '[web]\npassword_file = "page.passwords"\n'
    parts = (camera, BALL, broker, page, NEAR)
    found = lacking(tmp_path, *parts)
    assert [(code, key) for code, key, _ in found] == [
        ("driver-lacks", "camera.path"),
        ("driver-lacks", "messenger.password_file"),
        ("driver-lacks", "web.password_file"),
    ]
    assert f"there is no file {tmp_path / 'gone.mp4'}" in found[0][2]
    for name in ("gone.mp4", "secret.txt", "page.passwords"):
        (tmp_path / name).touch()
    assert lacking(tmp_path, *parts) == []


@pytest.mark.parametrize(("paths", "is_there"), [("shots", True), ("shots/*.jpg", True), ("shots/*.png", False)])
def test_pictures_may_be_a_folder_or_a_pattern(tmp_path, paths, is_there):
    (tmp_path / "shots").mkdir()
    (tmp_path / "shots" / "1.jpg").touch()
    camera = f'[camera]\ndriver = "images"\npaths = "{paths}"\n{LENS}'
    found = lacking(tmp_path, camera, BALL, NEAR)
    assert ("camera.paths" not in [key for _, key, _ in found]) is is_there


# A rule that the camera and the target cannot serve is told before anything runs.


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
