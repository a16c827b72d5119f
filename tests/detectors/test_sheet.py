"""The sheet detector on drawn pictures, whose truth is exact, and on real ones."""

from __future__ import annotations

import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.core.target import SheetSize
from stadimeter.detectors.sheet import PLUGIN, SheetOptions

pytestmark = pytest.mark.vision

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


def test_the_outline_goes_clockwise_from_the_top_left_corner(sheet_detector, draw, wall) -> None:
    found = sheet_detector().detect(draw.frame(draw.polygon(wall(), LANDSCAPE, PAPER)))
    assert np.asarray(found.outline_px) == pytest.approx(np.array(LANDSCAPE), abs=0.2)


def test_a_dark_sheet_on_a_light_wall_is_found(sheet_detector, draw, wall) -> None:
    picture = draw.polygon(wall(bgr=(210, 215, 220)), LANDSCAPE, (60, 50, 40))
    assert sheet_detector().detect(draw.frame(picture)).width_px == pytest.approx(220.3, abs=0.2)


def test_a_white_sheet_on_wood_is_found_though_both_are_equally_bright(sheet_detector, draw, wall) -> None:
    wood = wall(bgr=(110, 200, 225))
    grey = cv2.cvtColor(wood, cv2.COLOR_BGR2GRAY)[0, 0]
    picture = draw.noise(draw.polygon(wood, LANDSCAPE, (grey, grey, grey)))
    assert sheet_detector().detect(draw.frame(picture)).width_px == pytest.approx(220.3, abs=0.3)


@pytest.mark.parametrize("degrees", [0, 7, 20, 33])
def test_a_turned_sheet_keeps_its_size(sheet_detector, draw, wall, degrees: int) -> None:
    angle = math.radians(degrees)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    corners = (np.array([(-110, -85), (110, -85), (110, 85), (-110, 85)]) @ turn.T) + (320, 240)
    found = sheet_detector().detect(draw.frame(draw.noise(draw.polygon(wall(), corners, PAPER))))
    assert (found.width_px, found.height_px) == pytest.approx((220, 170), abs=0.3)


def test_the_centre_is_where_the_diagonals_meet_not_the_mean_of_the_corners(sheet_detector, draw, wall) -> None:
    corners = [(150, 120), (420, 170), (420, 310), (150, 360)]
    found = sheet_detector().detect(draw.frame(draw.polygon(wall(), corners, PAPER)))
    assert found.centre_px == pytest.approx((320.5, 240), abs=0.5)


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


def test_the_largest_of_several_sheets_is_taken(sheet_detector, draw, wall) -> None:
    picture = draw.polygon(wall(), [(40, 40), (150, 40), (150, 125), (40, 125)], PAPER)
    found = sheet_detector().detect(draw.frame(draw.polygon(picture, LANDSCAPE, PAPER)))
    assert found.width_px == pytest.approx(220.3, abs=0.3)


def test_writing_and_pictures_on_the_sheet_do_not_matter(sheet_detector, draw, wall) -> None:
    picture = draw.polygon(wall(), LANDSCAPE, PAPER)
    picture = draw.polygon(picture, [(230, 180), (390, 180), (390, 290), (230, 290)], (40, 40, 40))
    cv2.putText(picture, "stadimeter", (225, 172), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (0, 0, 0), 2)
    assert sheet_detector().detect(draw.frame(picture)).width_px == pytest.approx(220.3, abs=0.3)


def test_a_thumb_over_one_side_does_not_matter(sheet_detector, draw, wall) -> None:
    picture = draw.disc(draw.polygon(wall(), LANDSCAPE, PAPER), (420, 230), 20, (130, 160, 210))
    assert sheet_detector().detect(draw.frame(picture)).width_px == pytest.approx(220.3, abs=0.5)


@pytest.mark.parametrize("moved_by", [(-230, 0), (0, -180), (260, 0), (0, 200)], ids=["left", "top", "right", "bottom"])
def test_a_sheet_cut_off_by_the_border_is_truncated(sheet_detector, draw, wall, moved_by) -> None:
    corners = np.array(LANDSCAPE) + moved_by
    found = sheet_detector().detect(draw.frame(draw.noise(draw.polygon(wall(), corners, PAPER))))
    assert found.status is DetectionStatus.TRUNCATED
    assert "cut off by the border" in found.reason


def test_a_sheet_that_just_touches_the_border_is_truncated(sheet_detector, draw, wall) -> None:
    corners = np.array(LANDSCAPE) - (200.3, 0)
    found = sheet_detector().detect(draw.frame(draw.polygon(wall(), corners, PAPER)))
    assert found.status is DetectionStatus.TRUNCATED


def test_an_even_wall_has_no_contour_of_four_corners(sheet_detector, draw, wall) -> None:
    found = sheet_detector().detect(draw.frame(wall()))
    assert found.status is DetectionStatus.NOT_FOUND
    assert found.reason == "no contour of four corners"
    assert len(found.outline_px) == 0


@pytest.mark.parametrize("seed", range(6))
def test_noise_is_no_sheet(sheet_detector, draw, seed: int) -> None:
    noise = np.random.default_rng(seed).integers(0, 256, (480, 640, 3), np.uint8)
    for picture in (noise, cv2.GaussianBlur(noise, (0, 0), 9)):
        found = sheet_detector().detect(draw.frame(picture))
        assert found.status is DetectionStatus.NOT_FOUND
        assert found.reason


def test_a_ball_is_no_sheet(sheet_detector, draw, wall) -> None:
    for radius in (30, 60, 120):
        found = sheet_detector().detect(draw.frame(draw.disc(wall(), (320, 240), radius, PAPER)))
        assert found.status is DetectionStatus.NOT_FOUND


def test_a_sheet_that_is_too_small_says_how_small(sheet_detector, draw, wall) -> None:
    corners = [(300, 200), (320, 200), (320, 215), (300, 215)]
    found = sheet_detector().detect(draw.frame(draw.polygon(wall(), corners, PAPER)))
    assert found.status is DetectionStatus.NOT_FOUND
    assert re.fullmatch(r"largest four-cornered contour is 1[5-7] px wide, limit 20 px", found.reason)


def test_a_ribbon_is_too_long_for_a_sheet(sheet_detector, draw, wall) -> None:
    corners = [(100, 200), (500, 200), (500, 240), (100, 240)]
    found = sheet_detector().detect(draw.frame(draw.polygon(wall(), corners, PAPER)))
    assert re.search(r"is too long for the sheet: (9\.\d|10\.0) to 1, limit 2\.6 to 1", found.reason)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (2, 2), (7, 9)])
def test_a_tiny_picture_holds_no_sheet(sheet_detector, draw, shape) -> None:
    found = sheet_detector().detect(draw.frame(np.full((*shape, 3), 90, np.uint8)))
    assert found.status is DetectionStatus.NOT_FOUND


def test_the_frame_is_not_changed_and_gives_the_same_answer_again(sheet_detector, draw, wall) -> None:
    picture = draw.noise(draw.polygon(wall(), LANDSCAPE, PAPER))
    before = picture.copy()
    detector = sheet_detector()
    first, second = detector.detect(draw.frame(picture)), detector.detect(draw.frame(picture))
    assert np.array_equal(picture, before)
    assert first.width_px == second.width_px
    assert np.array_equal(first.outline_px, second.outline_px)


def test_the_target_size_is_what_the_options_say(sheet_detector) -> None:
    size = sheet_detector(known_side="height").target_size
    assert size == SheetSize(width_m=pytest.approx(0.2794), height_m=pytest.approx(0.2159), known_side="height")


@pytest.mark.parametrize(
    "wrong", [{"width": "0 in"}, {"height": "-1 in"}, {"width": 11}, {"known_side": "depth"}, {"min_side_px": 1}]
)
def test_wrong_options_are_refused(wrong) -> None:
    with pytest.raises(ValidationError):
        SheetOptions.model_validate({"width": "11 in", "height": "8.5 in", **wrong})


def test_the_plugin_names_the_target_after_its_table(driver_context) -> None:
    options = PLUGIN.options.model_validate({"width": "11 in", "height": "8.5 in"})
    detector = PLUGIN.build(options, driver_context("letter"))
    assert detector.detect(Frame(np.zeros((20, 20, 3), np.uint8), 0.0, 0)).target == "letter"


def _read(path: Path) -> Image:
    return cv2.imread(str(path))


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


def test_no_real_picture_of_a_ball_holds_a_sheet(real_pictures: Path, sheet_detector, draw) -> None:
    names = ("44.5_0", "89_0", "89_60", "116_0", "116_60")
    for name in names:
        found = sheet_detector().detect(draw.frame(_read(real_pictures / "tennis_ball" / "images" / f"{name}.jpg")))
        assert found.status is not DetectionStatus.FOUND, name
