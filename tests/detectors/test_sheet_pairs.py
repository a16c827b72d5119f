"""Strips of tape side by side, and what is named by one side."""

from __future__ import annotations

import numpy as np
import pytest

from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.ranging.measure import measure
from support.scenes.draw import CAMERA

pytestmark = pytest.mark.vision

WHITE, BLACK = (228, 232, 230), (12, 12, 12)


def found(draw, wall, sides_px: tuple[float, float], **options: str) -> Detection:
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * sides_px / 2 + (320.3, 240.2)
    image = draw.noise(draw.polygon(wall(bgr=BLACK), corners, WHITE))
    detector = SheetDetector("strip", SheetOptions.model_validate({"width": "10 cm", "height": "5 cm", **options}))
    return detector.detect(Frame(image, 0.0, 0), lens=CAMERA)


@pytest.mark.parametrize("sides_px", [(100, 90), (60, 100), (100, 30)])
def test_a_known_side_takes_nothing_of_quite_another_shape(draw, wall, sides_px) -> None:
    assert found(draw, wall, sides_px, known_side="width").status is DetectionStatus.NOT_FOUND


def test_a_strip_is_measured_by_its_known_side_where_the_other_one_is_four_pixels_high(draw, wall) -> None:
    def strip(width_px: float, height_px: float, **options: float) -> Detection:
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width_px, height_px) / np.array(2) + (160.3, 120.2)
        image = draw.noise(draw.polygon(wall(320, 240, BLACK), corners, WHITE))
        sides = {"width": "10 cm", "height": "4 cm", "known_side": "width"}
        detector = SheetDetector("strip", SheetOptions.model_validate(sides | options))
        return detector.detect(Frame(image, 0.0, 0), lens=CAMERA)

    assert strip(10, 4).width_px == pytest.approx(10, abs=0.3)
    assert "7 px by its known side, limit 8 px" in strip(7, 4).reason
    assert strip(7, 4, min_side_px=5).width_px == pytest.approx(7, abs=0.5)


def test_one_of_fifteen_squares_alike_is_measured_where_their_colour_is_named(draw, wall) -> None:
    image, random = wall(bgr=(215, 210, 205)), np.random.default_rng(3)
    for column, row in np.ndindex(5, 3):
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 13 + (80 + 115 * column, 90 + 140 * row)
        image = draw.polygon(image, corners + random.uniform(-0.4, 0.4, (4, 2)), (70, 110, 30))
    options = SheetOptions.model_validate({"width": "5 cm", "height": "5 cm", "hsv": "65,80,50:95,255,200"})
    seen = SheetDetector("square", options).detect(Frame(draw.noise(image), 0.0, 0), lens=CAMERA)
    assert seen.is_whole, seen.reason
    assert (seen.width_px, seen.height_px) == pytest.approx((26, 26), rel=0.04)


def test_a_known_side_that_seems_turned_away_has_a_wide_standard_deviation(draw, wall) -> None:
    shape = SheetOptions.model_validate({"width": "10 cm", "height": "5 cm", "known_side": "width"}).shape
    facing, turned = (found(draw, wall, sides, known_side="width") for sides in ((100, 50), (94, 50)))
    sure, unsure = (measure(each, shape, CAMERA, 0.0) for each in (facing, turned))
    assert unsure.sigma_m > 3 * sure.sigma_m
    assert abs(unsure.distance_m - 0.6) < 2 * unsure.sigma_m
