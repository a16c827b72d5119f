"""What `check` warns of about drivers: cameras and bases that are nothing for motion."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from support.simulated_run import SIMULATED_BALL

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
