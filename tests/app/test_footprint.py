"""The memory of a whole run: one target, MQTT by a real broker, alarms that are remembered, and people who may ask."""

import json
import subprocess
import sys

import cv2
import numpy as np
import pytest

from support.broker import MosquittoBroker
from support.programs import needs

PEAK_MB = 100
"""In 10⁶ bytes. 91 were measured; a library that `run` does not need, or pictures that are kept, take more."""
PICTURES = 150
RULES = """
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[actuators.buzzer]
driver = "simulated"

[messenger]
driver = "mqtt"
host = "127.0.0.1"
port = {port}
node = "footprint"

[rules.too-close]
actuator = "buzzer"
severity = "alarm"
when = {{ below = "1.5 m", deadband = "5 cm" }}

[rules.gone]
when = {{ lost = true }}
"""
CAMERA = """
[camera]
driver = "images"
paths = [{paths}]

[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0
fy_px = 600.0
cx_px = 319.5
cy_px = 239.5
"""


@pytest.mark.long
@needs("mosquitto")
def test_a_run_with_a_target_a_broker_and_alarms_takes_little_memory(tmp_path):
    rng = np.random.default_rng(1)
    for number in range(PICTURES):
        picture = rng.integers(80, 100, (480, 640, 3), dtype=np.uint8)
        cv2.circle(picture, (150 + 2 * number, 240), 25 + number // 2, (60, 200, 120), -1, cv2.LINE_AA)
        cv2.imwrite(str(tmp_path / f"{number:03}.jpg"), cv2.GaussianBlur(picture, (5, 5), 1.0))
    paths = ", ".join(['"*.jpg"'] * 4)
    broker = MosquittoBroker(tmp_path)
    broker.start()
    try:
        (tmp_path / "run.toml").write_text(CAMERA.format(paths=paths) + RULES.format(port=broker.port))
        ran = subprocess.run(
            [sys.executable, "-m", "stadimeter", "run", "run.toml", "--speed", "0", "--json",
             "--state", "state.sqlite3", "--socket", "socket"],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
    finally:
        broker.stop()
    assert ran.returncode == 0, ran.stderr
    summary = json.loads(ran.stdout)
    assert summary["frames"] == 4 * PICTURES
    assert summary["events"]["raised"] >= 4
    assert 40 < summary["peak_memory_mb"] < PEAK_MB
