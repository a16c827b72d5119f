"""What `check` warns of about drivers: what wears them out, and what nobody uses."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from support.simulated_run import SIMULATED_BALL

PARTS = f"""{SIMULATED_BALL}
[actuators.siren]
driver = "relay"
pin = 17
[world]
"""


def warned(tmp_path: Path, text: str) -> list[tuple[str, str, str]]:
    path = tmp_path / "run.toml"
    path.write_text(f'{PARTS}\n[rules.far]\nactuator = "motor"\nwhen = {{ above = "1 m" }}\n{text}')
    warnings = load_configuration(path).warnings
    codes = ("relay-pattern", "output-unused")
    return [(each.code, each.key, each.message) for each in warnings if each.code in codes]


@pytest.mark.parametrize("where", ["rule", "step"])
def test_a_relay_that_clicks_all_the_time_is_warned_of(tmp_path: Path, where: str) -> None:
    pattern = 'actuator = "siren"\npattern = { on = "0.5 s", off = "0.5 s" }'
    rule = '[rules.near]\nwhen = { below = "1 m" }\n'
    text = rule + (pattern if where == "rule" else f"[[rules.near.escalation]]\n{pattern}")
    key = "rules.near.pattern" if where == "rule" else "rules.near.escalation.0.pattern"
    message = "'siren' wears out by switching, as a relay does, and would switch every 1 s while the alarm stands"
    assert ("relay-pattern", key, message) in warned(tmp_path, text)


@pytest.mark.parametrize("pattern", ['{ on = "0.5 s", off = "0.5 s", times = 3 }', '{ on = "5 s", off = "5 s" }'])
def test_a_relay_that_clicks_seldom_is_fine(tmp_path: Path, pattern: str) -> None:
    text = f'[rules.near]\nactuator = "siren"\nwhen = {{ below = "1 m" }}\npattern = {pattern}\n'
    assert warned(tmp_path, text) == []


CAMERA = """
[camera]
driver = "opencv"
device = "{device}"
{more}
model = {{ width_px = 640, height_px = 480, fx_px = 600.0, fy_px = 600.0, cx_px = 319.5, cy_px = 239.5 }}
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"
"""
MOVES = """
[actuators.motor]
driver = "vibration-motor"
pin = 18
[rules.far]
actuator = "motor"
ramp = { from = "1 m", to = "2 m" }
"""
TELLS = """
[messenger]
driver = "simulated"
[rules.far]
when = { above = "1 m" }
"""


def said_of_the_camera(tmp_path: Path, text: str, device: str, more: str = "") -> list[tuple[str, str]]:
    path = tmp_path / "run.toml"
    path.write_text(CAMERA.format(device=device, more=more) + text)
    codes = ("not-for-motion", "latency-too-long")
    return [(each.code, each.key) for each in load_configuration(path).warnings if each.code in codes]


@pytest.mark.parametrize(
    ("device", "more", "said"),
    [
        ("/dev/video0", "", []),
        ("http://cam/stream", 'latency = "80 ms"', []),
        ("rtsp://cam/live", "", [("not-for-motion", "camera.latency")]),
        ("http://cam/stream", 'latency = "120 ms"', [("latency-too-long", "camera.latency")]),
        ("http://cam/stream", 'latency = "300 ms"', [("latency-too-long", "camera.latency")]),
        ("udp://127.0.0.1:5000", 'latency = "80 ms"', [("not-for-motion", "camera.accept_lossy_stream")]),
        ("udp://127.0.0.1:5000", 'latency = "80 ms"\naccept_lossy_stream = true', []),
    ],
)
def test_what_a_stream_means_for_motion_is_warned_of(
    tmp_path: Path, device: str, more: str, said: list[tuple[str, str]]
) -> None:
    assert said_of_the_camera(tmp_path, MOVES, device, more) == said
    assert said_of_the_camera(tmp_path, TELLS, device, more) == []


BASE = f"""{SIMULATED_BALL}
[world]
[base]
driver = "ros-arduino-bridge"
port = "{{port}}"
wheel_diameter = "65 mm"
ticks_per_turn = 1440
track_width = "16 cm"
{{more}}
"""


@pytest.mark.parametrize(
    ("port", "more", "said"),
    [
        ("/dev/ttyUSB0", "", [("base-stops-late", "base.driver")]),
        ("/dev/ttyUSB0", 'auto_stop = "500 ms"', []),
        ("/dev/ttyUSB0", 'auto_stop = "600 ms"', [("base-stops-late", "base.auto_stop")]),
        ("/dev/ttyUSB0", 'auto_stop = "0 s"', [("base-never-stops-by-itself", "base.auto_stop")]),
        ("emulated-ros-arduino-bridge", 'auto_stop = "0 s"', []),
    ],
)
def test_a_base_that_drives_on_for_long_without_us_is_warned_of(
    tmp_path: Path, port: str, more: str, said: list[tuple[str, str]]
) -> None:
    path = tmp_path / "run.toml"
    path.write_text(BASE.format(port=port, more=more))
    warnings = load_configuration(path).warnings
    assert [(each.code, each.key) for each in warnings if each.code.startswith("base-")] == said
    assert all("AUTO_STOP_INTERVAL" in each.hint for each in warnings if each.code.startswith("base-"))
