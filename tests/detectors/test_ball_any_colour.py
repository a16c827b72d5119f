"""Balls whose colour is not given: found by their outline alone."""

from __future__ import annotations

import numpy as np
import pytest

from stadimeter.core.detection import DetectionStatus
from stadimeter.detectors.ball.circle_votes import list_octaves, propose_circles
from support.scenes import draw as scenes
from support.scenes.hard_balls import silver_ball
from support.scenes.render import render

pytestmark = pytest.mark.vision

RED, GREY = (40, 30, 200), (150, 150, 150)


@pytest.mark.parametrize("radius", [12, 75])
@pytest.mark.parametrize("colour", [RED, GREY])
def test_a_ball_of_any_colour_is_measured_without_one(ball_detector, draw, wall, radius: float, colour) -> None:
    found = ball_detector(hsv=None).detect(draw.frame(draw.noise(draw.disc(wall(), (320.2, 240.4), radius, colour))))
    assert found.status is DetectionStatus.FOUND
    assert found.centre_px == pytest.approx((320.2, 240.4), abs=0.5)
    assert abs(found.width_px - 2 * radius) < max(3 * found.size_sigma_px, 0.5)


@pytest.mark.long
def test_most_silver_balls_are_found_and_hardly_one_is_far_off(ball_detector, draw) -> None:
    errors = []
    for seed in range(20):
        made = render(silver_ball(seed, (12.0, 70.0)).scene)
        found = ball_detector(hsv=None).detect(draw.frame(made.image))
        if found.is_whole:
            errors.append(abs(found.width_px / made.truth.apparent_px - 1))
    assert len(errors) >= 16
    assert np.median(errors) < 0.02
    assert np.count_nonzero(np.array(errors) > 0.1) <= 1


@pytest.mark.long
def test_clutter_and_squares_show_no_ball(ball_detector, draw, wall) -> None:
    square = draw.polygon(wall(), [(200, 150), (300, 150), (300, 250), (200, 250)], RED)
    pictures = [square, wall(), *(render(scenes.empty_scene(seed)).image for seed in range(5))]
    for picture in pictures:
        assert ball_detector(hsv=None).detect(draw.frame(draw.noise(picture))).status is not DetectionStatus.FOUND


def test_pictures_too_small_for_a_ball_propose_none() -> None:
    for shape in ((1, 1, 3), (10, 400, 3), (24, 24, 3)):
        octaves = list_octaves(np.full(shape, 90, np.uint8))
        assert [circle for octave in octaves for circle in propose_circles(octave)] == []
