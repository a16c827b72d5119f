"""A Raspberry Pi's own camera from its calibration to a run, on a double of its package."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import Result
from msgspec.structs import replace
from typer.testing import CliRunner

from stadimeter.app.clock import MonotonicClock
from stadimeter.cli.main import app
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.config.plugins import CAMERAS, DETECTORS, DriverChoice, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.ranging.calibration import calibrate
from stadimeter.workbench.calibration.live_distance import take_at
from stadimeter.workbench.frame_source import open_camera
from support.picamera2_double import Sensor, install
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene

LENS = CameraModel.with_focal_length(600.0, 640, 480)
BALL = {"diameter": "20 cm", "hsv": "20,60,40:50,255,255"}
CAMERA = {"width_px": 640, "height_px": 480, "rate": "100 Hz", "focus": "1 m"}
CONFIGURATION = """\
[camera]
driver = "picamera2"
model = "camera.toml"
width_px = 640
height_px = 480
rate = "100 Hz"
focus = "1 m"

[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "20,60,40:50,255,255"

[rules.near]
target = "ball"
when = { below = "50 cm" }
"""


def ball_at(near_side_m: float) -> Image:
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    return render(Scene(camera=LENS, target=ball, seed=1, backdrop=PlainBackdrop())).image


def choice(group: str, driver: str, table: dict[str, object]) -> DriverChoice:
    model = load_driver(group, driver)
    return DriverChoice(name=driver, driver=driver, options=model.model_validate(table))


@pytest.fixture
def sensor(monkeypatch: pytest.MonkeyPatch) -> Sensor:
    sensor = Sensor(MonotonicClock(), picture=ball_at(1.0))
    install(sensor, monkeypatch)
    return sensor


@pytest.fixture
def configuration(sensor: Sensor, tmp_path: Path) -> Path:
    """Calibrate before the camera, and return a configuration with the camera file."""
    camera = open_camera(choice(CAMERAS, "picamera2", CAMERA))
    with camera as source:
        take = take_at(source, choice(DETECTORS, "ball", BALL), 1.0)
        made = calibrate([take.known], date="2026-01-01").camera_model
        save_camera_model(tmp_path / "camera.toml", replace(made, optics=take.frame.optics))
    file = tmp_path / "ball.toml"
    file.write_text(CONFIGURATION)
    return file


def run(configuration: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["run", str(configuration), "--frames", "5", "--no-state", *options])


@pytest.mark.long
def test_calibrating_records_how_the_camera_was_set_and_a_run_with_the_same_settings_measures(
    sensor: Sensor, configuration: Path
) -> None:
    optics = load_camera_model(configuration.with_name("camera.toml")).optics
    assert optics is not None
    assert (optics.sensor, optics.crop_px, optics.lens_position_dpt) == ("imx708", (0, 0, 4608, 2592), 1.0)
    sensor.picture = ball_at(2.0)
    journal = configuration.with_name("run.jsonl")
    done = run(configuration, "--journal", str(journal))
    assert done.exit_code == 0, done.output
    distances_m = [float(found) for found in re.findall(r'"distance_m":\s*([\d.]+)', journal.read_text())]
    assert distances_m
    assert distances_m == pytest.approx([2.1] * len(distances_m), rel=0.02)
