"""Several balls of one colour in one picture."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from stadimeter.app.clock import SteppedClock
from stadimeter.config.plugins import DriverContext
from stadimeter.core.detection import DetectionStatus, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.ball import BallDetector, BallOptions
from stadimeter.detectors.protocol import FindsSeveral, TracksSeveral
from support.scenes.ball import BallTarget
from support.scenes.cut_sheet import GroupTarget
from support.scenes.draw import CAMERA
from support.scenes.render import render
from support.scenes.scene import Scene

DIAMETER_M = 0.067
APART = ((-0.3, -0.1, 1.5), (0.25, 0.1, 1.1), (0.0, 0.0, 1.3))
TOUCHING = ((-0.04, 0.0, 1.0), (0.04, 0.0, 1.2), (0.3, 0.1, 1.1))  # the first covers a little of the second
NOTHING = ((0.0, 0.0, 80.0),)


def detector(count: int | None) -> BallDetector:
    options = BallOptions.model_validate({"diameter": "6.7 cm", "hsv": "29,86,6:64,255,255", "count": count})
    return options.build(DriverContext(name="balls", clock=SteppedClock()))


def frame_of(places: tuple[tuple[float, float, float], ...]) -> Frame:
    balls = [BallTarget(position_m=place, diameter_m=DIAMETER_M) for place in sorted(places, key=lambda p: p[2])]
    target = GroupTarget(first=balls[0], others=tuple(balls[1:]))
    return Frame(render(Scene(camera=CAMERA, target=target, seed=5)).image, 0.0, 0)


def distances_m(count: int, places: tuple[tuple[float, float, float], ...]) -> list[float]:
    found = detector(count).detect_all(frame_of(places), lens=CAMERA)
    shape = detector(count).target_shape
    return sorted(math.hypot(*shape.locate(each, CAMERA).position_m) for each in found)


@pytest.mark.parametrize("places", [APART, TOUCHING], ids=["apart", "touching"])
def test_every_ball_is_found_and_measured(places: tuple[tuple[float, float, float], ...]) -> None:
    assert distances_m(3, places) == pytest.approx(sorted(math.hypot(*place) for place in places), rel=0.02)


def test_without_a_ball_the_reason_is_that_of_a_single_one() -> None:
    frame = frame_of(NOTHING)
    (several,), one = detector(3).detect_all(frame, lens=CAMERA), detector(None).detect(frame, lens=CAMERA)
    assert (several.status, several.reason) == (one.status, one.reason)
    assert several.status is DetectionStatus.NOT_FOUND


def test_near_a_prediction_that_ball_is_found_and_elsewhere_none() -> None:
    frame = frame_of(APART)
    place = BallTarget(position_m=APART[0], diameter_m=DIAMETER_M)
    size_px = place.apparent_px(CAMERA)
    x_px, y_px = CAMERA.pixel(APART[0][0] / APART[0][2], APART[0][1] / APART[0][2])
    here = Prediction(centre_px=(x_px + 1, y_px), size_px=size_px, sigma_px=2.0)
    there = Prediction(centre_px=(x_px + 100, y_px - 80), size_px=size_px, sigma_px=2.0)
    found = detector(3).detect_near(frame, here, lens=CAMERA)
    assert found.centre_px == pytest.approx((x_px, y_px), abs=0.5)
    assert detector(3).detect_near(frame, there, lens=CAMERA).status is DetectionStatus.NOT_FOUND


def test_only_a_table_with_a_count_finds_several() -> None:
    assert isinstance(detector(2), TracksSeveral)
    assert not isinstance(detector(None), FindsSeveral)


def test_several_balls_need_a_colour() -> None:
    with pytest.raises(ValidationError, match="add hsv beside count"):
        BallOptions.model_validate({"diameter": "6.7 cm", "count": 3})
