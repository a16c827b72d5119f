"""What the page on limits says: how far targets are found, and what is not measured, kept or driven."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.config.loader import load_configuration
from stadimeter.config.schema import configuration_schema
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.ball import BallDetector, BallOptions
from stadimeter.detectors.disc import DiscDetector, DiscOptions
from stadimeter.detectors.protocol import Detector
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.detectors.tag import TagDetector, TagOptions
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.similar_triangles import expect
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.scenes.target import Target

ROOT = Path(__file__).resolve().parents[2]
PAGE = " ".join((ROOT / "docs" / "what-it-does-not-do.md").read_text(encoding="utf-8").split())
REPORT = (ROOT / "docs" / "benchmarks" / "report.md").read_text(encoding="utf-8")
WEBCAM = CameraModel.with_focal_length(600.0, 640, 480)
GREEN = "20,60,40:50,255,255"


def detector_of(kind: str, size: str) -> Detector:
    match kind:
        case "ball":
            return BallDetector(kind, BallOptions.model_validate({"diameter": size, "hsv": GREEN}))
        case "sheet":
            return SheetDetector(kind, SheetOptions.model_validate({"size": size}))
        case "disc":
            return DiscDetector(kind, DiscOptions.model_validate({"diameter": size}))
    return TagDetector(kind, TagOptions.model_validate({"side": size}))


def looked_for(kind: str, size: str, image: Image) -> Detection:
    return detector_of(kind, size).detect(Frame(image, 0.0, 0), lens=WEBCAM)


def at_a_wall(target: Target, seed: int) -> Image:
    return render(Scene(camera=WEBCAM, target=target, seed=seed, backdrop=PlainBackdrop(bgr=(90, 84, 80)))).image


def facing(away_m: float, seed: int) -> Pose:
    place = (0.003 * away_m * seed, 0.02 * away_m, away_m)
    return Pose(position_m=place, tilt_rad=0.1, tilt_towards_rad=float(seed))


@pytest.mark.vision
@pytest.mark.parametrize(
    ("kind", "size", "away_m", "written"),
    [
        ("ball", "tennis ball", 4.0, "tennis ball 4 m"),
        ("ball", "20 cm", 12.0, "ball of 20 cm 12 m"),
        ("sheet", "A4", 10.0, "A4 10 m"),
        ("tag", "8 cm", 3.0, "tag of 8 cm 3 m"),
    ],
)
def test_so_far_a_target_is_found_before_a_plain_wall(kind: str, size: str, away_m: float, written: str) -> None:
    assert written in PAGE
    for seed in range(5):
        pose = facing(away_m, seed)
        targets: dict[str, Target] = {
            "tennis ball": BallTarget(position_m=pose.position_m, diameter_m=0.067),
            "20 cm": BallTarget(position_m=pose.position_m, diameter_m=0.2),
            "A4": SheetTarget(pose=pose, width_m=0.297, height_m=0.21),
            "8 cm": TagTarget(pose=pose, side_m=0.08, number=7),
        }
        found = looked_for(kind, size, at_a_wall(targets[size], seed))
        assert found.status is DetectionStatus.FOUND, found.reason


def figures(section: str, row: str) -> list[str]:
    """Return the cells of the first row of a section of the report that begins so."""
    part = REPORT.partition(f"\n{section}\n")[2]
    (line, *_) = [each for each in part.splitlines() if each.startswith(f"| {row} |")]
    return [each.strip() for each in line.strip("|").split("|")]


def test_how_many_are_found_in_clutter_stands_in_the_report() -> None:
    near, far = figures("## Balls as they are met", "all"), figures("The same with a radius from 5 to 10 px.", "all")
    tags = [figures("## Tag", f"{size} px")[5] for size in (16, 24)]
    shares = [round(float(each[3].split()[0])) for each in (far, near)]
    shares += [int(re.findall(r"\((\d+)\)", each)[0]) for each in tags]
    assert f"{shares[0]} % are found at 10 to 20 px, {shares[1]} %" in PAGE
    assert f"of tags {shares[2]} % at 16 px, {shares[3]} % at 24 px" in PAGE


def test_the_error_of_a_far_target_grows_at_least_with_the_square_of_the_distance() -> None:
    near, far = (expect(BallShape(diameter_m=0.2), WEBCAM, away_m).sigma_m for away_m in (3.0, 9.0))
    assert far / near > 9


@cache
def room(seed: int) -> Image:
    nothing = BallTarget(position_m=(50.0, 0.0, 1.0), diameter_m=0.01)
    return render(Scene(camera=WEBCAM, target=nothing, seed=seed, backdrop=RoomBackdrop())).image


SIZES = {"ball": "tennis ball", "sheet": "A4", "disc": "12 cm", "tag": "8 cm"}


@pytest.mark.vision
@pytest.mark.parametrize("kind", SIZES)
def test_what_is_no_target_has_no_distance(kind: str) -> None:
    found = [looked_for(kind, SIZES[kind], room(seed)).status for seed in range(3)]
    assert DetectionStatus.FOUND not in found


@pytest.mark.parametrize("kind", SIZES)
def test_in_the_dark_nothing_is_found(kind: str) -> None:
    noise = np.random.default_rng(1).integers(0, 6, (480, 640, 3)).astype(np.uint8)
    assert looked_for(kind, SIZES[kind], noise).status is DetectionStatus.NOT_FOUND


@pytest.mark.vision
def test_a_disc_that_the_border_cuts_off_has_no_distance() -> None:
    disc = DiscTarget(pose=Pose(position_m=(-0.52, 0.0, 1.0)), diameter_m=0.12)
    assert looked_for("disc", "12 cm", at_a_wall(disc, 1)).status is not DetectionStatus.FOUND


def test_a_frame_has_one_distance_for_each_target_and_no_map() -> None:
    runner = CliRunner()
    helped = [runner.invoke(app, [*words, "--help"]).stdout for words in (["measure"], ["run"], ["snapshot"])]
    assert not any(re.search(r"depth map|point cloud|disparity", " ".join(each.split())) for each in helped)


def test_no_neural_network_comes_with_it() -> None:
    assert [*(ROOT / "src").rglob("*.onnx"), *(ROOT / "src").rglob("*.tflite"), *(ROOT / "src").rglob("*.rpk")] == []


def test_it_is_for_linux_and_python_3_11() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    systems = [each for each in project["classifiers"] if each.startswith("Operating System")]
    assert (project["requires-python"], systems) == (">=3.11", ["Operating System :: POSIX :: Linux"])


def test_a_stop_says_that_it_is_no_emergency_stop() -> None:
    helped = CliRunner().invoke(app, ["outputs", "--help"]).stdout
    assert "no emergency stop" in " ".join(helped.split())


def test_without_a_table_no_picture_is_kept() -> None:
    for file in sorted((ROOT / "config").glob("*.toml")):
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
        configuration = load_configuration(file)
        assert (configuration.recording is None) == ("recording" not in tables)
        assert (configuration.black_box is None) == ("black_box" not in tables)


def test_a_base_only_follows_and_turns() -> None:
    schema = str(configuration_schema())
    assert re.findall(r"\b(?:obstacle|waypoint|route)s?\b", schema) == []
