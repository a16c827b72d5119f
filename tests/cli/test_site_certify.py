"""`site certify`: a simulated world without a person, pictures at taped distances, and a person before a camera."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from support.command_line import Typed, typed
from support.scenes.backdrop import Backdrop, PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = pytest.mark.vision

CONFIGURATION = """
[camera]
driver = "images"
paths = ["{pictures}"]
rate = "10 Hz"
model = {{ width_px = 640, height_px = 480, fx_px = 600.0, edge_bias_sigma_px = 0.03 }}

[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "20,60,40:50,255,255"

[actuators.motor]
driver = "simulated"

[rules.near]
actuator = "motor"
when = {{ below = "1 m" }}

[rules.far]
actuator = "motor"
when = {{ above = "4 m" }}
"""
FRAMES = 6


@cache
def ball_at(near_side_m: float, backdrop: Backdrop) -> Image:
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    lens = CameraModel.with_focal_length(600.0, 640, 480)
    return render(Scene(camera=lens, target=ball, seed=1, backdrop=backdrop)).image


PLAIN = PlainBackdrop()


def pictures_at(folder: Path, near_side_m: float | None, backdrop: Backdrop = PLAIN) -> Path:
    """Write pictures that differ by noise only, of a ball at a distance, or of nothing."""
    rng = np.random.default_rng(3)
    folder.mkdir(exist_ok=True)
    image = np.full((480, 640, 3), 90, np.uint8) if near_side_m is None else ball_at(near_side_m, backdrop)
    for frame in range(FRAMES):
        noisy = np.clip(np.rint(image + rng.normal(0, 1, image.shape)), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{frame}.png"), noisy)
    return folder


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Return a configuration that shows a ball at 1 m, with pictures at 0.6 m, 1 m and 2 m beside it."""
    for name, at_m in (("near", 0.6), ("middle", 1.0), ("far", 2.0), ("nothing", None)):
        pictures_at(tmp_path / name, at_m)
    file = tmp_path / "site.toml"
    file.write_text(CONFIGURATION.format(pictures=tmp_path / "middle" / "*.png"))
    return file


def run(site: Path, *options: str, answers: str = "") -> Typed:
    return typed("site", "certify", site, *options, answers=answers)


def given(site: Path, *names: str) -> list[str]:
    return [option for name in names for option in ("--pictures", str(site.parent / name))]


@pytest.mark.long
def test_pictures_at_three_distances_give_a_certificate(site: Path) -> None:
    result = run(site, "--at", "60cm,1m,2m", *given(site, "near", "middle", "far"))
    assert result.returncode == 0, result
    lines = result.stdout.splitlines()
    assert [line.split(":")[0] for line in lines[:3]] == ["0.6 m", "1 m", "2 m"]
    assert lines[3].startswith("Scale: distances are ")
    assert lines[-1] == f"wrote {site.with_suffix('.certificate.json')}, and .html beside it"
    made = json.loads(site.with_suffix(".certificate.json").read_text())
    assert abs(made["fit"]["scale"]) < 0.01
    again = run(site, "--at", "60cm,1m,2m", *given(site, "near", "middle", "far"), "--json")
    assert json.loads(again.stdout)["fit"]["scale"] == pytest.approx(made["fit"]["scale"])
    assert "Scale: distances are " in again.stderr
    checked = typed("check", site, "--elsewhere")
    assert "far: above 4.00 m: by the certificate of" in " ".join(checked.stdout.split())
    strict = typed("check", site, "--elsewhere", "--strict", "--json")
    assert strict.returncode == 1
    assert [each["code"] for each in json.loads(strict.stdout)["warnings"]] == ["not-carried"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--at", "1m,2m"), "--pictures is given 3 times and --at names 2 distances"),
        (("--at", "1m,2m,200m"), "200 m is no distance for a tape"),
        (("--at", "1m,2m,3m", "--tape", "2 m"), "certifies nothing"),
    ],
)
def test_bad_options_are_one_clear_error_each(site: Path, options: tuple[str, ...], words: str) -> None:
    result = run(site, *options, *given(site, "near", "middle", "far"))
    assert result.returncode == 2
    assert words in result.stderr


@pytest.mark.long
def test_a_person_types_the_distance_skips_one_and_stops_and_nothing_is_lost(site: Path) -> None:
    # The pictures show 1 m, whatever is asked for: the first is as it is, the second is typed, the third is skipped.
    result = run(site, "--at", "60cm,2m,3m,4m", answers="1 m ± 3 mm\nskip\n5 parsec\n")
    assert result.returncode == 1
    assert "Measure with a tape, from the lens to the target's nearest point." in result.stdout
    assert "1 m: seen in 6 of 6 frames" in result.stdout
    assert "parsec" in result.stderr
    assert "stopped; what was measured is kept, and the same command goes on" in result.stderr
    (kept,) = json.loads(site.with_suffix(".placements.json").read_text())["placements"]
    assert (kept["tape_m"], kept["tape_sigma_m"]) == (1.0, 0.003)
