"""A detector of another package, with a shape that stadimeter knows nothing of: every command takes it."""

from __future__ import annotations

import json
import math
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec import Struct
from typer.testing import CliRunner, Result

from stadimeter.cli.main import app
from stadimeter.config import plugins
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction, Reading
from stadimeter.core.frame import Frame, Image
from stadimeter.workbench.annotation import GREEN

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
SIDE_M, DEPTH_M = 0.4, 1.6
ORANGE = (0, 120, 250)


class Triangle(Struct, frozen=True):
    """An equilateral triangle that stands upright, such as a warning sign."""

    side_m: float
    relative_sigma: float = 0.0
    limb_radius_m: float = 0.0
    has_corners: bool = True

    @property
    def label(self) -> str:
        return f"triangle of {self.side_m:g} m"

    @property
    def longest_m(self) -> float:
        return self.side_m

    @property
    def shortest_m(self) -> float:
        return self.side_m * math.sqrt(0.75)

    def size_sigma_px(self, size_px: float) -> float:
        return 0.3

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        apparent = detection.width_px / camera.fx_px
        depth_m = self.side_m / apparent
        x, y = camera.direction(*detection.centre_px)
        share = detection.size_sigma_px / detection.width_px
        return Reading(position_m=(x * depth_m, y * depth_m, depth_m), noise_share=share)


class TriangleOptions(DriverOptions):
    side: Length
    least_red: int = 200

    def build(self, context: DriverContext) -> TriangleDetector:
        return TriangleDetector(self, context.name)


class TriangleDetector:
    """Takes whatever is orange for the triangle."""

    def __init__(self, options: TriangleOptions, name: str) -> None:
        self._name = name
        self._least_red = options.least_red
        self.target_shape = Triangle(side_m=options.side)

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        rows, columns = np.nonzero((frame.image[:, :, 2] >= self._least_red) & (frame.image[:, :, 0] < 100))
        if not len(rows):
            return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason="nothing is orange")
        left, right, top, bottom = columns.min(), columns.max() + 1, rows.min(), rows.max() + 1
        corners = np.array(((left, bottom), ((left + right) / 2, top), (right, bottom)), np.float64) - 0.5
        x, y = corners.mean(axis=0)
        return Detection(
            target=self._name,
            status=DetectionStatus.FOUND,
            outline_px=corners,
            centre_px=(float(x), float(y)),
            width_px=float(right - left),
            height_px=float(bottom - top),
            size_sigma_px=0.3,
            quality=1.0,
        )


def drawn(depth_m: float) -> Image:
    """Draw the triangle facing the camera, its lower side's middle at the centre of the picture."""
    image = np.full((480, 640, 3), 60, np.uint8)
    half = CAMERA.fx_px * SIDE_M / depth_m / 2
    corners = ((-half, 0.0), (0.0, -2 * half * math.sqrt(0.75)), (half, 0.0))
    fixed = np.rint(np.add(corners, (CAMERA.cx_px, CAMERA.cy_px)) * 16).astype(np.int32)
    cv2.fillPoly(image, [fixed], ORANGE, shift=4)
    return image


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the package, as its entry point in `stadimeter.detectors` does."""
    entry = EntryPoint(name="triangle", value=f"{__name__}:TriangleOptions", group=plugins.DETECTORS)

    def with_triangle(group: str) -> tuple[EntryPoint, ...]:
        return (*entry_points(group=group), *([entry] if group == plugins.DETECTORS else []))

    monkeypatch.setattr(plugins, "installed", with_triangle)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_camera_model(tmp_path / "camera.toml", CAMERA)
    (tmp_path / "pictures").mkdir()
    for number, depth_m in enumerate((1.0, DEPTH_M, 2.4)):
        cv2.imwrite(str(tmp_path / "pictures" / f"{number}.png"), drawn(depth_m))
    return tmp_path


def invoked(*arguments: object) -> Result:
    result = CliRunner().invoke(app, list(map(str, arguments)))
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


TARGET = ("--target", "triangle side=40cm")


def test_it_is_measured_and_drawn_into_a_copy(folder: Path) -> None:
    picture = folder / "pictures" / "1.png"
    asked = ("--camera", folder / "camera.toml", *TARGET, "--json", "--explain", "--annotate", folder / "copies")
    result = invoked("measure", picture, *asked)
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    assert record["target"] == "triangle"
    assert record["depth_m"] == pytest.approx(DEPTH_M, rel=0.02)
    copy = cv2.imread(str(folder / "copies" / "1-measured.png"))
    # Half way up the left side: the outline joins the three corners, though they are further apart than a rim's points.
    scale = copy.shape[0] / 480
    corners = np.array(((CAMERA.cx_px - 75, CAMERA.cy_px), (CAMERA.cx_px, CAMERA.cy_px - 130)))
    x, y = (scale * corners.mean(axis=0)).astype(int)
    assert (copy[y - 6 : y + 7, x - 6 : x + 7] == GREEN).all(axis=2).any()


def test_a_camera_is_calibrated_and_checked_on_it(folder: Path) -> None:
    near, far = (f"{folder / 'pictures' / name}@{depth}m" for name, depth in (("0.png", 1.0), ("2.png", 2.4)))
    made = invoked("calibrate", "distance", near, far, *TARGET, "-o", folder / "made.toml")
    assert made.exit_code == 0, made.output
    assert load_camera_model(folder / "made.toml").fx_px == pytest.approx(600.0, rel=0.02)
    picture = f"{folder / 'pictures' / '1.png'}@{DEPTH_M}m"
    checked = invoked("calibrate", "check", picture, "--camera", folder / "camera.toml", *TARGET)
    assert checked.exit_code == 0, checked.output


CONFIGURATION = """
[camera]
driver = "images"
paths = "pictures"
rate = "10 Hz"
model = "camera.toml"
[targets.sign]
detector = "triangle"
side = "40 cm"
[rules.near]
when = {{ below = "{below}" }}
"""


def test_a_rule_watches_it_in_a_run(folder: Path) -> None:
    (folder / "run.toml").write_text(CONFIGURATION.format(below="1.2 m"), encoding="utf-8")
    result = invoked("run", folder / "run.toml", "--journal", folder / "run.jsonl")
    assert result.exit_code == 0, result.output
    distances = [
        measured["distance_m"]
        for line in (folder / "run.jsonl").read_text(encoding="utf-8").splitlines()
        for measured in (json.loads(line).get("observation") or {}).get("measurements", ())
    ]
    assert distances == pytest.approx([1.0, DEPTH_M, 2.4], rel=0.05)


def test_check_knows_from_how_far_it_can_be_found(folder: Path) -> None:
    for below, is_resolvable in (("1.2 m", True), ("60 m", False)):
        (folder / "run.toml").write_text(CONFIGURATION.format(below=below), encoding="utf-8")
        said = json.loads(invoked("check", folder / "run.toml", "--json").stdout)
        assert ("unresolvable" not in [each.get("code") for each in said.get("warnings", ())]) is is_resolvable
