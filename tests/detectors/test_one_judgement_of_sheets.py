"""A sheet is judged alike when it is looked for, calibrated from and measured; what mends a refusal was tried."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.config.camera_file import camera_file_text, load_camera_model
from stadimeter.config.plugins import DETECTORS, DriverChoice, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.workbench.calibration.live_distance import DistanceFit, fit_distances, look_at_distance, remedy_words
from stadimeter.workbench.measuring import remedies_for
from support.each_case import each_case
from support.scenes import hard_flats
from support.scenes.draw import CAMERA, empty_scene
from support.scenes.render import render

pytestmark = pytest.mark.vision

SMALL = CameraModel.with_focal_length(300.0, 320, 240)
SQUARE = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
STRIP = {"width": "2 in", "height": "5.5 in"}
STRIP_M = np.array((2, 5.5)) * 0.0254
LIT, DARK, PAPER, WALL = (130, 245, 150), (24, 20, 22), (228, 232, 230), (70, 100, 120)
FOUND = DetectionStatus.FOUND


def sheet(**options: str) -> DriverChoice:
    model = load_driver(DETECTORS, "sheet")
    return DriverChoice(name="sheet", driver="sheet", options=model.model_validate(options))


def seen(choice: DriverChoice, image: Image, lens: CameraModel | None = None) -> Detection:
    (target,) = build_detectors([choice], lens)
    return target.detector.detect(Frame(image, 0.0, 0), lens=lens)


def calibrated(choice: DriverChoice, image: Image, depth_m: float) -> DistanceFit | None:
    """Calibrate from one picture; None where the sheet is not found in it before the lens is known."""
    frame = Frame(image, 0.0, 0)
    (target,) = build_detectors([choice], None)
    known = look_at_distance("picture", frame, depth_m, target)
    fit = partial(fit_distances, distance_relative_sigma=0.01)
    return fit([known], lambda _: frame, [choice]) if known.detection.status is FOUND else None


def agree(choice: DriverChoice, image: Image, depth_m: float, lens: CameraModel) -> None:
    """Require that what measures calibrates, and that what calibrates is measured with the file and right."""
    fit = calibrated(choice, image, depth_m)
    made = fit and fit.calibration
    measured = seen(choice, image, lens)
    if measured.status is FOUND:
        assert made, f"measured, but it does not calibrate: {fit and fit.left_out[0].detection.reason}"
    if made:
        again = seen(choice, image, made.camera_model)
        assert again.status is FOUND, again.reason
        assert made.pictures[0].residual_share == pytest.approx(0, abs=0.002)


def two_strips(draw, lens: CameraModel, depth_m: float, noise_px: float, seed: int) -> Image:
    picture = np.full((lens.height_px, lens.width_px, 3), DARK, np.uint8)
    rng = np.random.default_rng(seed)
    for side in (-1, 1):
        place_m = SQUARE * STRIP_M / 2 + (side * 4.125 * 0.0254, 0)
        corners = place_m * lens.fx_px / depth_m + (lens.cx_px - 1.2, lens.cy_px + 0.6)
        picture = draw.polygon(picture, corners + rng.normal(0, noise_px, (4, 2)), LIT)
    return draw.noise(picture)


@pytest.mark.parametrize("lens", [CAMERA, SMALL], ids=["640x480", "320x240"])
@pytest.mark.parametrize("feet", [1, 6])
@pytest.mark.parametrize(
    "more", [{"known_side": "height"}, {"known_side": "height", "hsv": "45,80,100:85,255,255"}, {"tolerance": "2 mm"}]
)
def test_each_of_two_strips_of_tape_that_is_measured_calibrates(draw, lens, feet: int, more) -> None:
    depth_m = feet * 0.3048
    image = two_strips(draw, lens, depth_m, 0.1, feet)
    choice = sheet(**STRIP, **more)
    assert seen(choice, image, lens).status is FOUND
    agree(choice, image, depth_m, lens)


@pytest.mark.long
@given(seed=st.integers(0, 10**6), cut_mm=st.sampled_from((0.0, 1.0, 2.0)), known=st.sampled_from(("auto", "width")))
@settings(max_examples=10)
def test_what_measures_calibrates_and_what_calibrates_is_measured(seed: int, cut_mm: float, known: str) -> None:
    flat = hard_flats.hard_sheet(seed, cut_mm / 1000, (40.0, 250.0), tilts_deg=(0, 30))
    more = {"tolerance": f"{0.7 * cut_mm} mm"} if cut_mm else {}
    choice = sheet(width="10 cm", height="7.5 cm", known_side=known, **more)
    image, lens = render(flat.scene).image, CAMERA
    if not _measured_at_its_place(choice, image, flat):
        return  # another thing is at another distance, which its own depth does not calibrate
    agree(choice, image, float(flat.scene.target.position_m[2]), lens)


def _measured_at_its_place(choice: DriverChoice, image: Image, flat: hard_flats.HardFlat) -> bool:
    corners = flat.scene.target.outline_m()
    there = CAMERA.project(corners[:, :2] / corners[:, 2:]).mean(axis=0)
    found = (seen(choice, image, lens) for lens in (None, CAMERA))
    return all(each.status is FOUND and math.dist(each.centre_px, there) < 5 for each in found)


@pytest.mark.long
@each_case("seed", range(6))
@each_case("options", [{"size": "A4", "known_side": "width"}, {**STRIP, "known_side": "height"}])
def test_clutter_is_no_sheet_before_the_lens_is_known_either(seed: int, options: dict[str, str]) -> None:
    assert seen(sheet(**options), render(empty_scene(seed + 40)).image).status is not FOUND


@pytest.mark.long
def test_real_sheets_that_calibrate_are_measured(real_pictures: Path) -> None:
    choice = sheet(size="letter")
    for feet in (2, 3, 4):
        image = cv2.imread(str(real_pictures / "seed_sheet" / f"{feet}ft.png"))
        fit = calibrated(choice, image, feet * 0.3048)
        assert fit is not None
        assert fit.calibration is not None
        assert seen(choice, image, fit.calibration.camera_model).status is FOUND


def test_the_file_that_is_written_gives_the_same_verdict(draw, tmp_path: Path) -> None:
    image = two_strips(draw, SMALL, 1.5, 0.1, 7)
    choice = sheet(**STRIP, known_side="height")
    fit = calibrated(choice, image, 1.5)
    assert fit is not None
    assert fit.calibration is not None
    (tmp_path / "camera.toml").write_text(camera_file_text(fit.calibration.camera_model), encoding="utf-8")
    assert seen(choice, image, load_camera_model(tmp_path / "camera.toml")).status is FOUND


SLIGHT_PX, CURL_PX = 3.5, 6.0
"""How far the corners of an A4 are off that appears 330 px long: one not quite flat, and one that is curled."""

FOCAL_PX = 1800.0


def curled(draw, off_px: float = CURL_PX) -> Image:
    """Return a picture of A4, 1.62 m away, which is not flat."""
    corners = SQUARE * np.array((0.297, 0.21)) / 2 * FOCAL_PX / 1.62 + (640.3, 480.2)
    corners += off_px * np.array([(1, 0), (1, 0), (-1, 0), (-1, 0)])
    return draw.noise(draw.polygon(np.full((960, 1280, 3), WALL, np.uint8), corners, PAPER))


def test_a_sheet_that_is_not_quite_flat_needs_no_tolerance(draw) -> None:
    image, choice = curled(draw, SLIGHT_PX), sheet(size="A4")
    for looked_through in (None, CameraModel.with_focal_length(FOCAL_PX, 1280, 960)):
        assert seen(choice, image, looked_through).status is FOUND


@pytest.mark.long
def test_a_sheet_that_is_not_flat_is_found_with_the_tolerance_that_is_proposed(draw) -> None:
    image, choice = curled(draw), sheet(size="A4")
    lens = CameraModel.with_focal_length(FOCAL_PX, 1280, 960)
    for looked_through in (None, lens):
        refused = seen(choice, image, looked_through)
        assert refused.status is DetectionStatus.NOT_FOUND
        first, *others = remedies_for(choice, refused, Frame(image, 0.0, 0), looked_through)
        assert first.key == "tolerance"
        assert "A5" not in [each.value for each in others]
        mended = replace(choice, options=first.options)
        assert seen(mended, image, looked_through).status is FOUND
        agree(mended, image, 1.62, lens)


@pytest.mark.long
def test_what_is_said_of_a_sheet_that_does_not_calibrate_makes_it_calibrate(draw) -> None:
    image, choice = curled(draw), sheet(size="A4")
    frame = Frame(image, 0.0, 0)
    (target,) = build_detectors([choice], None)
    said = remedy_words(look_at_distance("picture", frame, 1.62, target), frame, choice)
    assert said.startswith('; it is found with tolerance = "')
    tolerance = said.split('"')[1]
    fit = calibrated(sheet(size="A4", tolerance=tolerance), image, 1.62)
    assert fit is not None
    assert fit.calibration is not None


def test_an_empty_wall_has_no_remedy() -> None:
    image, choice = np.full((240, 320, 3), WALL, np.uint8), sheet(size="A4")
    assert remedies_for(choice, seen(choice, image), Frame(image, 0.0, 0), None) == []
