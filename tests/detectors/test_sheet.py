"""The sheet detector on drawn pictures, whose truth is exact, and on real ones."""

from __future__ import annotations

import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.detectors.sheet.edges import SheetPicture, refine_corners
from support.each_case import each_case
from support.scenes.backdrop import PlainBackdrop
from support.scenes.draw import CAMERA, sheet_scene
from support.scenes.nuisances import BARREL
from support.scenes.plane import Pose, SheetTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.through_lens import ThroughLens

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

LETTER_M = np.array((0.2794, 0.2159))
A4 = {"width": "29.7 cm", "height": "21 cm"}
PAPER = (228, 232, 230)
LANDSCAPE = [(200.3, 150.7), (420.6, 150.7), (420.6, 320.9), (200.3, 320.9)]


def test_a_sheet_facing_the_camera_is_measured_to_a_fifth_of_a_pixel(sheet_detector, draw, wall) -> None:
    found = sheet_detector().detect(draw.frame(draw.noise(draw.polygon(wall(), LANDSCAPE, PAPER))))
    assert found.status is DetectionStatus.FOUND
    assert found.target == "paper"
    assert found.reason == ""
    assert (found.width_px, found.height_px) == pytest.approx((220.3, 170.2), abs=0.2)
    assert found.centre_px == pytest.approx((310.45, 235.8), abs=0.1)
    assert 0 < found.size_sigma_px < 1
    assert 0 < found.quality <= 1


def test_a_white_sheet_on_wood_is_found_though_both_are_equally_bright(sheet_detector, draw, wall) -> None:
    wood = wall(bgr=(110, 200, 225))
    grey = cv2.cvtColor(wood, cv2.COLOR_BGR2GRAY)[0, 0]
    picture = draw.noise(draw.polygon(wood, LANDSCAPE, (grey, grey, grey)))
    assert sheet_detector().detect(draw.frame(picture)).width_px == pytest.approx(220.3, abs=0.3)


def seen_at(pose: Pose, camera: CameraModel = CAMERA) -> np.ndarray:
    placed = pose.placed(np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * LETTER_M / 2)
    return camera.project(placed[:, :2] / placed[:, 2:])


def test_the_centre_is_where_the_diagonals_meet_not_the_mean_of_the_corners(sheet_detector, draw, wall) -> None:
    pose = Pose(position_m=(0.02, 0.01, 0.6), tilt_rad=0.9, tilt_towards_rad=0.2)
    corners = seen_at(pose)
    found = sheet_detector().detect(draw.frame(draw.polygon(wall(), corners, PAPER)))
    centre = CAMERA.project(np.array([[0.02 / 0.6, 0.01 / 0.6]]))[0]
    assert found.centre_px == pytest.approx(centre, abs=0.5)
    assert math.dist(centre, corners.mean(axis=0)) > 5


def test_a_sheet_under_light_that_falls_off_across_the_picture_is_found(sheet_detector, draw, wall) -> None:
    light = np.linspace(1.0, 0.15, 640)[None, :, None]
    picture = draw.polygon(wall(bgr=(90, 120, 140)), LANDSCAPE, (200, 205, 210)) * light
    found = sheet_detector().detect(draw.frame(draw.noise(picture)))
    assert (found.width_px, found.height_px) == pytest.approx((220.3, 170.2), abs=0.4)


def test_a_larger_object_that_is_no_sheet_does_not_win(sheet_detector, draw, wall) -> None:
    picture = draw.polygon(wall(), [(20, 380), (620, 395), (620, 460), (20, 445)], (240, 240, 240))
    picture = draw.polygon(picture, [(480, 30), (600, 90), (560, 330), (500, 200), (450, 300)], (30, 220, 220))
    picture = draw.disc(picture, (90, 110), 80, (250, 250, 250))
    found = sheet_detector().detect(draw.frame(draw.noise(draw.polygon(picture, LANDSCAPE, PAPER))))
    assert found.width_px == pytest.approx(220.3, abs=0.3)


def test_a_sheet_that_is_too_small_says_how_small(sheet_detector, draw, wall) -> None:
    corners = [(300, 200), (320, 200), (320, 215), (300, 215)]
    found = sheet_detector(min_side_px=20).detect(draw.frame(draw.polygon(wall(), corners, PAPER)))
    assert found.status is DetectionStatus.NOT_FOUND
    assert re.search(r"outline, (1[89]|2\d) px long, is refused: 1[3-6] px wide, limit 20 px", found.reason)


def test_a_ribbon_is_too_long_for_a_sheet(sheet_detector, draw, wall) -> None:
    corners = [(100, 200), (500, 200), (500, 240), (100, 240)]
    found = sheet_detector().detect(draw.frame(draw.polygon(wall(), corners, PAPER)))
    assert found.status is DetectionStatus.NOT_FOUND
    assert re.search(r"too long for the sheet: \d+\.\d to 1, limit 3\.8 to 1|from those of the sheet", found.reason)


def _read(path: Path) -> Image:
    return cv2.imread(str(path))


@pytest.mark.long
@pytest.mark.parametrize("name", ["2ft", "3ft", "4ft"])
def test_the_real_sheet_is_found_at_both_sizes_and_they_agree(
    real_pictures: Path, sheet_detector, draw, name: str
) -> None:
    folder = real_pictures / "seed_sheet"
    small = sheet_detector().detect(draw.frame(_read(folder / f"{name}.png")))
    large = sheet_detector().detect(draw.frame(_read(folder / "original" / f"{name}.jpg")))
    assert small.status is large.status is DetectionStatus.FOUND
    assert large.width_px / small.width_px == pytest.approx(2448 / 600, rel=0.002)
    assert large.height_px / small.height_px == pytest.approx(2448 / 600, rel=0.002)


@pytest.mark.long
def test_no_real_picture_of_a_ball_holds_a_sheet(real_pictures: Path, sheet_detector, draw) -> None:
    names = ("44.5_0", "89_0", "89_60", "116_0", "116_60")
    for name in names:
        found = sheet_detector().detect(draw.frame(_read(real_pictures / "tennis_ball" / "images" / f"{name}.jpg")))
        assert found.status is not DetectionStatus.FOUND, name


def with_camera(camera: CameraModel | None = CAMERA, **options: object) -> ThroughLens:
    sides = {} if "size" in options else A4
    return ThroughLens(SheetDetector("paper", SheetOptions.model_validate({**sides, **options})), camera)


def worst_px(found: np.ndarray, truth: np.ndarray) -> float:
    """Return how far the corners are from the true ones, whichever comes first."""
    return float(np.abs(found[:, None] - truth[None]).max(axis=2).min(axis=0).max())


@pytest.mark.long
@each_case("plain", [True, False], ids=["plain", "clutter"])
@each_case("seed", [1, 2, 4])
def test_corners_of_rendered_sheets_are_right_to_a_fraction_of_a_pixel(seed: int, plain: bool) -> None:
    for tilt in (0.0, 0.5, 1.0):
        made = render(sheet_scene(seed, tilt, plain=plain))
        found = with_camera().detect(Frame(made.image, 0.0, 0))
        assert found.status is DetectionStatus.FOUND, (tilt, found.reason)
        assert worst_px(found.outline_px, made.truth.outline_px) < (0.15 if plain else 0.4), tilt
        assert 0 < found.size_sigma_px < 0.5


def test_a_lens_that_bends_the_sides_does_not_matter_if_it_is_known() -> None:
    camera = replace(CAMERA, distortion=BARREL)
    for seed in (6, 9):
        scene = replace(sheet_scene(seed, 0.5, plain=True), camera=camera)
        made = render(scene)
        found = with_camera(camera).detect(Frame(made.image, 0.0, 0))
        assert worst_px(found.outline_px, made.truth.outline_px) < 0.1


@pytest.mark.parametrize(("paper", "behind"), [(PAPER, (70, 100, 120)), ((20, 20, 20), (190, 195, 200))])
def test_the_edge_bias_of_the_camera_is_taken_off_bright_and_dark_sheets(draw, wall, paper, behind) -> None:
    corners = seen_at(Pose(position_m=(0.0, 0.0, 1.0)))
    picture = draw.polygon(wall(bgr=behind), corners, paper)
    plain, biased = (
        with_camera(replace(CAMERA, edge_bias_px=bias), width="11 in", height="8.5 in").detect(draw.frame(picture))
        for bias in (0.0, 0.5)
    )
    sign = 1 if paper == PAPER else -1
    assert plain.width_px - biased.width_px == pytest.approx(sign * 1.0, abs=1e-6)
    assert plain.height_px - biased.height_px == pytest.approx(sign * 1.0, abs=1e-6)


def test_a_rectangle_of_another_shape_is_not_the_sheet_once_the_lens_is_known(draw, wall) -> None:
    square = seen_at(Pose(position_m=(0.0, 0.0, 0.8))) * (0.7, 1.0) + np.array((100, 0))
    picture = draw.frame(draw.noise(draw.polygon(wall(), square, PAPER)))
    found = with_camera(width="11 in", height="8.5 in").detect(picture)
    assert found.status is DetectionStatus.NOT_FOUND
    assert re.search(r"sides 1\.\d+ : 1, not 1\.29 : 1; about 279 x 2\d\d mm would fit$", found.reason)
    (refused,) = found.rejected[:1]
    assert math.dist(refused.centre_px, square.mean(axis=0)) < 3
    assert refused.size_px == pytest.approx(162, abs=20)
    assert refused.reason in found.reason


def test_how_well_the_size_is_known_follows_from_the_tolerance() -> None:
    size = with_camera(width="40 cm", height="10 cm", tolerance="1 mm").target_shape
    assert size.relative_sigma == pytest.approx(0.001 / 0.2)
    assert with_camera().target_shape.relative_sigma == 0


def test_a_side_that_is_not_named_may_have_any_length(draw, wall) -> None:
    corners = np.array([(200, 150), (400, 150), (400, 320), (200, 320)])
    picture = draw.frame(draw.polygon(wall(), corners, PAPER))
    assert with_camera(width="20 cm", height="12 cm").detect(picture).status is DetectionStatus.NOT_FOUND
    assert (
        with_camera(width="20 cm", height="12 cm", known_side="width").detect(picture).status is DetectionStatus.FOUND
    )


LETTER_ON_A_WALL = render(
    Scene(
        camera=CAMERA,
        target=SheetTarget(pose=Pose(position_m=(0.02, 0.01, 0.9)), width_m=LETTER_M[0], height_m=LETTER_M[1]),
        seed=3,
        backdrop=PlainBackdrop(),
    )
)


def test_letter_in_place_of_a4_is_said_where_it_is_refused() -> None:
    found = with_camera(size="A4").detect(Frame(LETTER_ON_A_WALL.image, 0.0, 0))
    assert found.status is DetectionStatus.NOT_FOUND
    assert re.search(r"sides 1\.(2[789]|3\d) : 1, not 1\.41 : 1: letter instead of A4\?$", found.reason)


def test_a_page_of_another_size_is_named_before_what_is_written_on_it(draw, wall) -> None:
    page = draw.polygon(wall(), [(80.0, 120.0), (560.0, 120.0), (560.0, 360.0), (80.0, 360.0)], PAPER)
    letter = draw.polygon(page, [(300.0, 200.0), (320.0, 200.0), (318.0, 260.0), (300.0, 230.0)], (20, 20, 20))
    found = with_camera(size="A4").detect(draw.frame(letter))
    assert found.status is DetectionStatus.NOT_FOUND
    assert found.rejected[0].size_px == pytest.approx(480, abs=2)
    assert found.reason.endswith("is refused: sides 2.00 : 1, not 1.41 : 1; about 297 x 148 mm would fit")


def test_an_outline_from_beyond_what_the_lens_reaches_is_none() -> None:
    camera = replace(CAMERA, distortion=(-0.3, 0.0, 0.0, 0.0))
    corners_px = np.array([[-900.0, -700.0], [400.0, 60.0], [420.0, 300.0], [60.0, 320.0]])
    assert np.isnan(camera.directions(corners_px)).any()
    assert refine_corners(SheetPicture.of(LETTER_ON_A_WALL.image, camera), corners_px, 2.0) is None
