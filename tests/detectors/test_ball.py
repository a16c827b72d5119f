"""The ball detector on drawn pictures, whose truth is exact, and on real ones."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.ball import BallDetector
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.measure import measure

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

RED, GREEN = (40, 30, 200), (40, 200, 80)
GREEN_HSV = "29,86,6:64,255,255"


def test_a_red_ball_is_found_though_its_hue_wraps_through_zero(ball_detector, draw, wall) -> None:
    for bgr in (RED, (60, 30, 200), (30, 45, 200)):  # hue 178, 175 and 3
        found = ball_detector().detect(draw.frame(draw.noise(draw.disc(wall(), (300.3, 200.7), 40.4, bgr))))
        assert found.status is DetectionStatus.FOUND
        assert found.centre_px == pytest.approx((300.3, 200.7), abs=0.2)
        assert found.width_px == pytest.approx(80.8, abs=0.4)
        assert found.height_px == found.width_px
        assert found.target == "ball"


@pytest.mark.parametrize("radius", [6.6, 10, 25, 75, 180])
def test_the_diameter_is_right_within_three_standard_deviations(ball_detector, draw, wall, radius: float) -> None:
    found = ball_detector().detect(draw.frame(draw.noise(draw.disc(wall(), (320.2, 240.4), radius, RED))))
    assert abs(found.width_px - 2 * radius) < 3 * found.size_sigma_px
    assert found.size_sigma_px < max(1.2, 0.05 * radius)


def test_what_was_refused_is_told_with_its_place_and_the_test_that_it_failed(ball_detector, draw, wall) -> None:
    picture = draw.polygon(wall(), [(100, 200), (500, 200), (500, 230), (100, 230)], RED)
    found = ball_detector().detect(draw.frame(draw.noise(picture)))
    assert found.status is DetectionStatus.NOT_FOUND
    assert any("limit" in each.reason for each in found.rejected)
    assert all(80 < each.centre_px[0] < 520 for each in found.rejected)


@pytest.mark.parametrize("radius", [5.4, 9, 14, 40, 150])
def test_in_a_large_picture_large_and_small_balls_are_found(ball_detector, draw, wall, radius: float) -> None:
    found = ball_detector().detect(draw.frame(draw.noise(draw.disc(wall(1280, 720), (640.3, 360.6), radius, RED))))
    assert found.centre_px == pytest.approx((640.3, 360.6), abs=0.3)
    assert found.width_px == pytest.approx(2 * radius, abs=1.0)


@pytest.mark.parametrize("seen_px", [0.0, 40.0])
def test_where_a_ball_is_expected_its_colour_is_judged_unless_it_is_seen_all_around(
    ball_detector, draw, wall, seen_px: float
) -> None:
    picture = draw.disc(wall(), (320, 240), 40, GREEN)
    if not seen_px:
        picture = draw.polygon(picture, [(320, 180), (380, 180), (380, 300), (320, 300)], (70, 100, 120))
    expected = Prediction(centre_px=(320, 240), size_px=80, sigma_px=1.0)
    detector, frame = ball_detector(), draw.frame(draw.noise(picture))
    assert detector.detect(frame).status is DetectionStatus.NOT_FOUND
    status = detector.detect(frame, expected).status
    assert status is (DetectionStatus.FOUND if seen_px else DetectionStatus.NOT_FOUND)


def test_edge_bias_is_undone_for_bright_and_for_dark_balls_by_their_contrast(ball_detector, draw, wall) -> None:
    plain = CameraModel.with_focal_length(600.0, 640, 480)
    biased = replace(plain, edge_bias_px=0.3)
    # By how much of the brighter side's light the darker side has less.
    for backdrop, contrast in (((20, 20, 20), -0.98), ((250, 250, 250), 0.67)):
        frame = draw.frame(draw.noise(draw.disc(wall(bgr=backdrop), (320, 240), 40, (90, 90, 220)), 1.0))
        before = ball_detector(plain, hsv="170,60,60:10,255,255").detect(frame)
        after = ball_detector(biased, hsv="170,60,60:10,255,255").detect(frame)
        assert after.width_px - before.width_px == pytest.approx(contrast * 0.6, abs=0.03)


def test_a_tolerance_of_the_diameter_makes_the_distance_less_sure(ball_detector, draw, wall) -> None:
    camera = CameraModel.with_focal_length(600.0, 640, 480)
    frame = draw.frame(draw.noise(draw.disc(wall(), (320, 240), 40, RED)))
    loose = ball_detector(camera, tolerance="3.2 mm")
    measured = measure(loose.detect(frame), loose.target_shape, camera, 0.0)
    assert loose.target_shape.relative_sigma == pytest.approx(0.05)
    assert measured.sigma_m / measured.distance_m == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize("hidden", ["left", "below", "corner"])
def test_a_ball_partly_hidden_keeps_its_size(ball_detector, draw, wall, hidden: str) -> None:
    covers = {
        "left": [(200, 150), (285, 150), (285, 350), (200, 350)],
        "below": [(220, 265), (420, 265), (420, 380), (220, 380)],
        "corner": [(320, 240), (420, 220), (420, 330), (300, 330)],
    }
    picture = draw.polygon(draw.disc(wall(), (320, 240), 50, RED), covers[hidden], (130, 160, 200))
    found = ball_detector().detect(draw.frame(draw.noise(picture)))
    assert found.status is DetectionStatus.FOUND
    assert found.width_px == pytest.approx(100, rel=0.03)
    assert found.centre_px == pytest.approx((320, 240), abs=2)


def test_motion_blur_widens_the_ball_no_more_than_it_smears_it(ball_detector, draw, wall) -> None:
    sharp = draw.disc(wall(), (320, 240), 40, RED)
    kernel = np.zeros((9, 9))
    kernel[4] = 1 / 9
    found = ball_detector().detect(draw.frame(draw.noise(cv2.filter2D(sharp, -1, kernel))))
    assert found.status is DetectionStatus.FOUND
    assert 78 < found.width_px < 88


def test_the_ball_wins_over_larger_things_of_its_colour(ball_detector, draw, wall) -> None:
    picture = draw.polygon(wall(), [(20, 20), (300, 30), (310, 90), (20, 100)], RED)
    picture = draw.polygon(picture, [(500, 300), (620, 300), (620, 330), (500, 460)], RED)
    found = ball_detector().detect(draw.frame(draw.noise(draw.disc(picture, (320, 300), 35, RED))))
    assert found.centre_px == pytest.approx((320, 300), abs=0.5)


def test_a_ball_that_is_too_small_says_how_small(ball_detector, draw, wall) -> None:
    found = ball_detector(min_radius_px=8).detect(draw.frame(draw.disc(wall(), (320, 240), 4, RED)))
    assert found.status is DetectionStatus.NOT_FOUND
    assert found.reason == "outline of 8 px lies in a circle of 8 px, limit 16 to 1280 px"


def test_a_refusal_names_the_thing_that_is_most_like_a_ball_and_not_a_larger_one(ball_detector, draw, wall) -> None:
    picture = draw.polygon(wall(), [(20, 20), (600, 20), (600, 50), (20, 50)], RED)
    picture = draw.disc(picture, (320, 300), 35, RED)
    picture = draw.polygon(picture, [(280, 260), (335, 260), (335, 340), (280, 340)], (200, 200, 200))
    found = ball_detector().detect(draw.frame(draw.noise(picture)))
    assert found.status is DetectionStatus.NOT_FOUND
    assert found.rejected[0].centre_px[1] > 200
    assert found.rejected[0].reason in found.reason


@pytest.mark.parametrize("is_grey", [True, False])
def test_a_picture_without_colour_is_said_to_be_grey(ball_detector, draw, wall, is_grey: bool) -> None:
    picture = draw.noise(draw.disc(wall(), (320.0, 240.0), 40, RED))
    picture = cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR) if is_grey else picture
    picture[:, :, 0] += 3  # as compression leaves it
    found = ball_detector(hsv=GREEN_HSV).detect(draw.frame(picture))
    assert found.reason.startswith("the picture is grey") is is_grey


def test_black_shows_every_hue_in_its_noise_and_is_no_ball(ball_detector, draw, wall) -> None:
    picture = draw.noise(draw.disc(wall(bgr=(180, 180, 180)), (320, 240), 40, (8, 8, 8)), 2.0)
    found = ball_detector(hsv="0,60,0:60,255,255").detect(draw.frame(picture))
    assert found.status is DetectionStatus.NOT_FOUND


TENNIS_CAMERA = CameraModel(
    width_px=1530,
    height_px=2040,
    fx_px=1449.03,
    fy_px=1449.08,
    cx_px=768.12,
    cy_px=1028.81,
    distortion=(0.205489723, -0.67305901, 0.000336320714, 0.000149915927, 0.666189722),
)


def _tennis_errors(real_pictures: Path, detector: BallDetector) -> list[float]:
    """Return the errors of the depth of the real tennis ball, for all pictures but the one in which it is cut off."""
    folder = real_pictures / "tennis_ball"
    with (folder / "truth.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    errors = []
    for row in rows:
        found = detector.detect(Frame(cv2.imread(str(folder / "images" / row["file"])), 0.0, 0))
        measured = measure(found, BallShape(diameter_m=0.064), TENNIS_CAMERA, 0.0)
        if row["file"] == "44.5_30.jpg":
            assert found.status is not DetectionStatus.FOUND, "the border cuts it off"
            assert measured.distance_m is None
        else:
            assert measured.depth_m is not None, f"{row['file']}: {measured.reason}"
            errors.append(abs(measured.depth_m / float(row["ball_centre_depth_m"]) - 1))
    assert len(errors) == 32
    return errors


@pytest.mark.long
def test_the_real_tennis_ball_is_measured_at_every_place_in_the_picture(real_pictures: Path, ball_detector) -> None:
    errors = _tennis_errors(real_pictures, ball_detector(hsv=GREEN_HSV, camera=TENNIS_CAMERA))
    assert np.median(errors) < 0.008
    assert np.percentile(errors, 90) < 0.017
    assert max(errors) < 0.025


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_green_ball_in_a_hand_is_found_in_the_video(real_pictures: Path, ball_detector) -> None:
    detector = ball_detector(hsv=GREEN_HSV)
    capture = cv2.VideoCapture(str(real_pictures / "ball_video" / "green_ball.mp4"))
    found = []
    while True:
        there, image = capture.read()
        if not there:
            break
        detection = detector.detect(Frame(image, 0.0, len(found)))
        found.append(detection.width_px if detection.is_whole else 0.0)
    capture.release()
    assert len(found) == 1004
    seen = [width / 2 for width in found if width]
    assert len(seen) >= 720
    assert not any(found[:25]), "there is no ball before frame 29"
    assert not any(found[975:]), "there is no ball after frame 960"
    assert np.percentile(seen, 2) > 18
    assert np.percentile(seen, 98) < 46
