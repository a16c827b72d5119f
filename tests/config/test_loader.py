"""A configuration is loaded whole, or refused with everything that is wrong with it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.plan import BaseOutput, LevelOutput
from stadimeter.errors import ConfigError, Problem

Load = Callable[[str], Configuration]
Problems = Callable[[str], tuple[Problem, ...]]
Told = Callable[[str], list[str]]


def line_of(text: str, fragment: str) -> int:
    return text[: text.index(fragment)].count("\n") + 1


def test_common_keys_are_not_handed_to_the_driver(load: Load, sound: str) -> None:
    text = sound.replace("pin = 18", 'pin = 18\nlease = "0.5 s"\nsafe = 0.25\nrise_per_s = 4')
    base = 'port = "/dev/ttyUSB0"\nmax_speed = "0.2 m/s"\nlease = "400 ms"\nafter_fault = "stay_off"'
    loaded = load(text.replace('port = "/dev/ttyUSB0"', base))
    assert loaded.stays_off == {"base"}
    assert loaded.leases_s == {"motor": 0.5, "buzzer": 0.3, "base": 0.4}
    assert loaded.plan.outputs[0] == LevelOutput(name="motor", safe_level=0.25, rise_per_s=4.0)
    assert loaded.plan.outputs[2] == BaseOutput(name="base", linear_max_mps=0.2, track_width_m=0.2)


def test_tracking_and_safety_reach_the_plan(load: Load, sound: str) -> None:
    loaded = load(sound + '[tracking]\ncoast = "1 s"\n[safety]\nmax_frame_age = "250 ms"\n')
    assert loaded.plan.tracking.coast_s == 1.0
    assert loaded.plan.safety.max_frame_age_s == 0.25


WRONG = """\
[camera]
driver = "opencvv"
model = 5
[targets.ball]
detector = "ball"
diameter = "0 cm"
hsv = "29,86,6:64,255,255"
[actuators.motor]
driver = "vibration-motor"
pin = 18
minimum_dutty = 0.3
[actuators.buzzer]
driver = "buzzer"
pin = 18
lease = 250
[actuators.lamp]
drivr = "led"
[messenger]
driver = "mqtt"
port = 99999
[rule.x]
[safety]
good_frames = 2.5
[rules.far]
actuator = "motr"
ramp = { from = "10 ft", to = "10 ft", bias = "cautius" }
[rules.near]
actuator = "buzzer"
severity = "alarmm"
when = { belwo = "50 cm" }
on_delay = { frames = 3 }
[rules.mid]
actuator = "base"
when = { between = ["2 m", "1 m"], deadband = "-1 m" }
"""

EXPECTED = [
    "2: camera.driver: no camera driver is called 'opencvv'; did you mean 'opencv'? There are: images, opencv, ",
    "3: camera.model: 5 is neither a camera file nor a table",
    "6: targets.ball.diameter: '0 cm' is not a length above zero",
    "11: actuators.motor.minimum_dutty: unknown key 'minimum_dutty' (did you mean 'minimum_duty'?)",
    "14: actuators.buzzer.pin: pin 18 is used twice: by actuators.motor.pin and by actuators.buzzer.pin (each needs ",
    "15: actuators.buzzer.lease: 250 has no unit; write it with one, such as '250 ms'",
    "16: actuators.lamp.driver: 'driver' is missing (there is 'drivr'; did you mean 'driver'?)",
    "20: messenger.port: 99999 is above 65535",
    "21: rule: unknown section 'rule' (did you mean 'rules'?)",
    "23: safety.good_frames: 2.5 is not a whole number",
    "25: rules.far.actuator: there is no actuator 'motr' (did you mean 'motor'?)",
    "26: rules.far.ramp.bias: 'cautius' is not one of: neutral, cautious, quiet (did you mean 'cautious'?)",
    "29: rules.near.severity: 'alarmm' is not one of: info, warning, alarm, safety (did you mean 'alarm'?)",
    "30: rules.near.when.belwo: unknown key 'belwo' (did you mean 'below'?)",
    "31: rules.near.on_delay.of: 'of' is missing",
    "33: rules.mid.actuator: there is no actuator 'base' (add a section [base])",
    "34: rules.mid.when.deadband: '-1 m' is below zero",
]


def test_every_error_is_reported_in_one_pass_in_the_order_of_the_file(problems_of: Problems) -> None:
    found = problems_of(WRONG)
    told = [str(problem).split("test.toml:")[1] for problem in found]
    assert [line[: len(words)] for line, words in zip(told, EXPECTED, strict=True)] == EXPECTED


BAD_INPUTS = [
    ('"6.4 cm"', '"nan cm"', "13: targets.ball.diameter: 'nan cm' is neither a length such as '6.4 cm' nor a ball"),
    ('"6.4 cm"', "nan", "13: targets.ball.diameter: nan has no unit; write it with one, such as '35 cm'"),
    ('"6.4 cm"', '"6.4"', "13: targets.ball.diameter: '6.4' has no unit; write it with one, such as '35 cm'"),
    ('diameter = "6.4 cm"', "", "11: targets.ball.diameter: 'diameter' is missing"),
    ("pin = 18", "pin = 99", "17: actuators.motor.pin: 99 is not a pin; write the BCM number of a GPIO, 0 to 27"),
    ("pin = 18", "pin = 18\nsafe = 1.5", "18: actuators.motor.safe: 1.5 is above 1"),
    ("pin = 18", "pin = 18\nsafe = nan", "18: actuators.motor.safe: nan is not a finite number"),
    ("pin = 18", "pin = 18\nsafe = true", "18: actuators.motor.safe: true is not a number"),
    ("pin = 18", 'pin = 18\nlease = "0 s"', "18: actuators.motor.lease: '0 s' is not a duration above zero"),
    ("[camera]", "[[camera]]", "1: camera: 'camera' is not a table (write it as [camera])"),
    ("[targets.ball]", "[[targets]]", "11: targets: 'targets' is not a table (write it as [targets.NAME])"),
    ("[targets.ball]", "[targets]", "12: targets.detector: 'detector' is not a table (write it below [targets.NAME])"),
    ("[actuators.motor]", "[actuators.base]", "15: actuators.base: 'base' cannot be a name here"),
    ("[actuators.motor]", "[actuators.'a b']", "15: actuators.a b: 'a b' cannot be a name here (use letters, digits,"),
    ('driver = "buzzer"', "driver = 5", "19: actuators.buzzer.driver: 5 is not text; put it in quotes"),
    ("[camera.model]", '[camera.modell]', "4: camera.modell: unknown key 'modell' (did you mean 'model'?)"),
]  # fmt: skip


def test_bad_input_gets_one_clear_line(problems_of: Problems, sound: str, subtests: pytest.Subtests) -> None:
    for old, new, words in BAD_INPUTS:
        with subtests.test(old=old, new=new):
            found = [str(problem).split("test.toml:")[1] for problem in problems_of(sound.replace(old, new, 1))]
            assert found[0].startswith(words)
            assert len(found) == 1 or new == "[targets]"


def test_what_is_no_text_file_is_no_configuration(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    for path, words in (
        (tmp_path / "nowhere.toml", r"nowhere\.toml: there is no such file"),
        (tmp_path, "the file cannot be read: it is a folder"),
        (
            tmp_path / "a.png",
            r"a\.png:1: .*it is not UTF-8 text \(it has the byte 0x89, in Windows-1252 ‰\) \(save it as UTF-8",
        ),
    ):
        with pytest.raises(ConfigError, match=words):
            load_configuration(path)


WRITTEN_ELSEWHERE = [
    ("diameter = “20 cm”", '“ (U+201C) is a typographic quote; write " in its place'),
    (
        '\u00a0diameter = "20 cm"',
        "there is a space of another kind (U+00A0) in this line; write an ordinary one in its place",
    ),
    ("latency = \u201320", "\u2013 (U+2013) is a dash; write - in its place"),
    ("when = { below = 50 cm }", 'text needs quotes: below = "50 cm"'),
    ("max_turn_rate = 90deg/s", 'text needs quotes: max_turn_rate = "90deg/s"'),
    ("diameter = ″20 cm″", '″ (U+2033) is a typographic quote; write " in its place'),
    ('dia\u200bmeter = "20 cm"', "a character that cannot be seen (U+200B) is in this line; leave it out"),
    ("pin = \uff118", "\uff11 (U+FF11) is not the 1 of a keyboard; write 1 in its place"),
    ("hue = 10° ± 1°", 'text needs quotes: hue = "10° ± 1°"'),
    ("port = /dev/ttyUSB0", 'text needs quotes: port = "/dev/ttyUSB0"'),
    ("of = [ball, tag]", 'text needs quotes: "tag"'),
    ("fx_px = 600,5", "a number has a decimal point: 600.5"),
    ("fx_px = .5", "a number has a digit before its point: 0.5"),
    ("fx_px = 600.", "a number has a digit behind its point: 600.0"),
    ("invert = yes", 'write true or false; as a text in quotes: "yes"'),
    ('safe = None # "off"', 'TOML has no None: leave the key out; as a text in quotes: "none"'),
    ('diameter: "20 cm"', "write = in place of :"),
    ('diameter = "20 cm" // of it', "behind a value stands nothing but a comment with #: leave out //"),
    ("; of it", "a comment begins with #, not with ;"),
    ("pin = 1\npin = 2", "the same key or section stands in the file twice; keep one"),
    ('when = { below = "1 m", below = "2 m" }', "the same key or section stands in the file twice; keep one"),
    ('size = "20 cm', "a text has no quote at its end, in this line or above"),
    ('of = ["a", "b"', "a [ has no ] in this line or above, or a comma is missing between two entries"),
    ('when = { below = "1 m", }', "leave out the comma before }"),
    ('model = "C:\\lens"', r"write \\ for each \, or the text in single quotes, such as 'C:\lens'"),
    (
        '{ "camera": 1 }',
        'this looks like JSON; a configuration is TOML, such as [camera] and below it driver = "opencv"',
    ),
    ('pin = "20" cm', "put what is behind the text into its quotes, or another key into a line of its own"),
    ("camera:", 'this looks like YAML; a configuration is TOML, such as [camera] and below it driver = "opencv"'),
]


def test_a_line_that_was_written_in_a_word_processor_or_without_quotes_says_what_to_write(tmp_path: Path) -> None:
    for line, words in WRITTEN_ELSEWHERE:
        path = tmp_path / "typed.toml"
        path.write_text(f"# \u201cquoted\u201d, and 5 cm wide\n{line}\n")
        with pytest.raises(ConfigError) as raised:
            load_configuration(path)
        (problem,) = raised.value.problems
        assert (problem.line, problem.hint) == (2 + line.count("\n"), words)


def test_a_text_of_another_encoding_is_named(tmp_path: Path) -> None:
    for encoding, words in (("latin-1", "0xFC, in Windows-1252 ü"), ("utf-16", "UTF-16"), ("utf-16-le", "UTF-8")):
        (tmp_path / "old.toml").write_bytes("# für\n".encode(encoding))
        with pytest.raises(ConfigError, match=words):
            load_configuration(tmp_path / "old.toml")


def test_an_empty_file_lacks_a_camera_and_a_target(told: Told) -> None:
    assert told("") == [
        'camera: the section [camera] is missing (add one, such as driver = "opencv")',
        "targets: there is no target (add one, such as [targets.ball])",
    ]


@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_other_line_ends_and_a_byte_order_mark_do_no_harm(tmp_path: Path, sound: str, end: str) -> None:
    file = tmp_path / "windows.toml"
    file.write_bytes(("\ufeff" + sound + "[rules.near]\nwhen = { belwo = 1 }\n").replace("\n", end).encode())
    with pytest.raises(ConfigError) as caught:
        load_configuration(file)
    assert [problem.line for problem in caught.value.problems] == [line_of(sound + "belwo", "belwo") + 1]


def test_a_camera_file_is_found_beside_the_configuration(tmp_path: Path, sound: str) -> None:
    head, _, rest = sound.partition("[camera.model]\n")
    inline, _, tail = rest.partition("[targets.ball]")
    (tmp_path / "lens.toml").write_text(inline)
    file = tmp_path / "test.toml"
    file.write_text(f'{head}model = "lens.toml"\n[targets.ball]{tail}')
    model = load_configuration(file).camera_model
    assert model is not None
    assert model.fx_px == 600.0


def test_what_is_wrong_inside_a_camera_file_comes_after_the_configuration(tmp_path: Path, sound: str) -> None:
    head, _, rest = sound.partition("[camera.model]\n")
    (tmp_path / "lens.toml").write_text("width_px = 640\n")
    file = tmp_path / "test.toml"
    file.write_text(f'{head}model = "lens.toml"\n[targets.ball]{rest.partition("[targets.ball]")[2]}[ruls]\n')
    with pytest.raises(ConfigError) as caught:
        load_configuration(file)
    first, *others = caught.value.problems
    assert first.message == "unknown section 'ruls'"
    assert others
    assert all("lens.toml" in str(problem) for problem in others)


@pytest.mark.parametrize("value", ["0.0", '"wide"'])
def test_what_is_wrong_in_an_inline_camera_model_is_placed_in_the_configuration(
    problems_of: Problems, sound: str, value: str
) -> None:
    (problem,) = problems_of(sound.replace("fx_px = 600.0", f"fx_px = {value}"))
    assert problem.key.startswith("camera.model")
    assert problem.line in {line_of(sound, "[camera.model]"), line_of(sound, "fx_px")}


def test_a_driver_whose_library_is_missing_is_said_so(told: Told, sound: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "stadimeter.messaging.mqtt", raising=False)
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    (line,) = told(sound + '[messenger]\ndriver = "mqtt"\n')
    assert "messenger.driver: the driver 'mqtt' needs a library that is not installed" in line


def test_a_wrong_test_of_rules_stops_check_and_no_run(tmp_path: Path, sound: str) -> None:
    file = tmp_path / "test.toml"
    file.write_text(f"{sound}[[tests]]\ninput = 3\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_configuration(file)
    assert [problem.key for problem in caught.value.problems] == ["tests.0.expect", "tests.0.input"]
    assert load_configuration(file, with_tests=False).tests == ()
