"""What the floor tells of a target's distance, and how the camera stands above it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel, LensUncertainty
from stadimeter.core.camera_pose import Footing
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.errors import CalibrationError
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import SheetShape, TagShape, UprightShape
from stadimeter.ranging.floor import OnFloor, camera_above, mean_of, stand
from stadimeter.ranging.measure import measure
from support.corners import detection_of_corners
from support.scenes.draw import CAMERA, TAG_M
from support.scenes.on_floor import OnFloorScene, tag_lying

# What the floor tells of a target's distance, beside its size.

BALL = BallShape(diameter_m=0.067)
HEIGHT_M, TILT_RAD = 0.3, math.radians(-12)
FOOTING = Footing(height_m=HEIGHT_M, height_sigma_m=0.005, tilt_rad=TILT_RAD, tilt_sigma_rad=math.radians(0.1))
SeenBall = Callable[..., Detection]


def in_camera(aside_m: float, below_m: float, ahead_m: float, tilt_rad: float = TILT_RAD) -> tuple[float, float, float]:
    """Return a place in the camera frame from one in level axes: right, down and ahead."""
    cosine, sine = math.cos(tilt_rad), math.sin(tilt_rad)
    return aside_m, below_m * cosine + ahead_m * sine, ahead_m * cosine - below_m * sine


def ball_at(seen_ball: SeenBall, ahead_m: float, below_m: float = HEIGHT_M - 0.0335) -> Detection:
    return seen_ball(in_camera(0.1 * ahead_m, below_m, ahead_m), 0.0335, sigma_px=0.3)


def stood(found: Detection, camera: CameraModel, footing: Footing = FOOTING, shape: BallShape = BALL) -> OnFloor:
    return stand(measure(found, shape, camera, 0.0), found, shape, camera, footing)


@pytest.mark.parametrize("ahead_m", [0.5, 1.0, 2.0, 4.0])
def test_a_ball_of_any_size_on_the_floor_has_its_true_distance(
    ahead_m: float, seen_ball: SeenBall, camera: CameraModel
) -> None:
    true_m = math.hypot(*in_camera(0.1 * ahead_m, HEIGHT_M - 0.0335, ahead_m))
    found = ball_at(seen_ball, ahead_m)
    for taken_for_m in (0.067, 0.1, 0.02):
        by_floor = stood(found, camera, shape=BallShape(diameter_m=taken_for_m)).distance_m
        assert by_floor == pytest.approx(true_m, rel=1e-4)


def test_what_is_known_to_be_so_high_and_what_lies_flat_have_their_true_distance(
    seen_ball: SeenBall, camera: CameraModel
) -> None:
    for centre_m in (0.0, 0.12):
        found = ball_at(seen_ball, 1.0, HEIGHT_M - centre_m)
        by_floor = stood(found, camera, replace(FOOTING, centre_m=centre_m)).distance_m
        assert by_floor == pytest.approx(math.hypot(*in_camera(0.1, HEIGHT_M - centre_m, 1.0)), rel=1e-4)


def test_a_turned_sheet_that_stands_has_its_true_distance(camera: CameraModel) -> None:
    shape, turn = SheetShape(width_m=0.297, height_m=0.21), 0.5
    corners = [
        in_camera(side * 0.297 / 2 * math.cos(turn), HEIGHT_M - up, 1.2 + side * 0.297 / 2 * math.sin(turn))
        for side, up in ((-1, 0.21), (1, 0.21), (1, 0.0), (-1, 0.0))
    ]
    corners_m = np.array(corners)
    found = Detection(
        target="sheet",
        status=DetectionStatus.FOUND,
        outline_px=camera.project(corners_m[:, :2] / corners_m[:, 2:]),
        centre_px=tuple(camera.project((corners_m[:, :2] / corners_m[:, 2:]).mean(axis=0)[None])[0].tolist()),
        width_px=130.0,
        height_px=100.0,
        size_sigma_px=0.05,
    )
    by_size = measure(found, shape, camera, 0.0)
    by_floor = stand(by_size, found, shape, camera, FOOTING)
    assert by_floor.distance_m == pytest.approx(math.hypot(*in_camera(0.0, HEIGHT_M - 0.105, 1.2)), rel=1e-3)
    assert by_floor.measurement.distance_m == pytest.approx(by_size.distance_m, rel=1e-3)


def test_both_together_are_surer_than_either(seen_ball: SeenBall, camera: CameraModel) -> None:
    unsure = BallShape(diameter_m=0.067, relative_sigma=0.02)
    both = stood(ball_at(seen_ball, 1.0), camera, shape=unsure)
    assert both.by_size.sigma_m is not None
    assert both.measurement.sigma_m is not None
    assert both.measurement.sigma_m < min(both.by_size.sigma_m, both.sigma_m)
    assert both.measurement.reason == ""
    assert both.measurement.noise_m is not None
    assert both.measurement.noise_m <= both.measurement.sigma_m


def test_the_stated_deviation_is_that_of_drawn_cameras(seen_ball: SeenBall, camera: CameraModel) -> None:
    rng, found = np.random.default_rng(7), ball_at(seen_ball, 2.0)
    sigmas = (4.0, 4.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    uncertainty = LensUncertainty(sigmas=sigmas, correlations=(0.9, *(0.0,) * 35))
    stated = stood(replace(found, size_sigma_px=1e-6), replace(camera, uncertainty=uncertainty))
    read = []
    for _ in range(400):
        fx, fy, cx, cy = rng.multivariate_normal(np.zeros(9), uncertainty.covariance())[:4]
        off = replace(
            camera, fx_px=camera.fx_px + fx, fy_px=camera.fy_px + fy, cx_px=camera.cx_px + cx, cy_px=camera.cy_px + cy
        )
        height_m, tilt = HEIGHT_M + 0.005 * rng.standard_normal(), TILT_RAD + math.radians(0.1) * rng.standard_normal()
        drawn = stood(found, off, replace(FOOTING, height_m=height_m, tilt_rad=tilt)).distance_m
        assert drawn is not None
        read.append(1 / drawn)
    assert stated.distance_m is not None
    # Of the inverse, in which it is worked out; and without the roll, which is not drawn and counts 1 % here.
    assert np.std(read) == pytest.approx(stated.sigma_m / stated.distance_m**2, rel=0.1)


def test_a_lifted_ball_is_said_to_contradict_and_the_size_counts_with_a_wider_deviation(
    seen_ball: SeenBall, camera: CameraModel
) -> None:
    both = stood(ball_at(seen_ball, 1.0, HEIGHT_M - 0.15), camera)
    measured, by_floor = both.measurement, both.distance_m
    assert both.apart_sigmas > 3
    assert measured.distance_m == both.by_size.distance_m
    assert by_floor is not None
    assert measured.distance_m is not None
    assert measured.sigma_m is not None
    assert abs(by_floor - measured.distance_m) <= 2 * measured.sigma_m
    assert measured.noise_m == both.by_size.noise_m
    assert "σ apart: it is not on the floor" in measured.reason


def test_a_ball_above_the_horizon_has_no_distance_by_the_floor_and_keeps_that_by_its_size(
    seen_ball: SeenBall, camera: CameraModel
) -> None:
    both = stood(ball_at(seen_ball, 2.0, -0.3), camera)
    assert both.distance_m is None
    assert both.measurement.distance_m == both.by_size.distance_m
    assert "not there by the floor" in both.measurement.reason


def test_of_a_size_that_is_not_known_the_floor_alone_counts(seen_ball: SeenBall, camera: CameraModel) -> None:
    unknown = BallShape(diameter_m=0.02, relative_sigma=math.inf)
    both = stood(ball_at(seen_ball, 1.0), camera, shape=unknown)
    assert both.measurement.distance_m == both.distance_m
    assert both.measurement.sigma_m == pytest.approx(both.sigma_m, rel=0.01)
    lifted = stood(ball_at(seen_ball, 2.0, -0.3), camera, shape=unknown).measurement
    assert (lifted.status, lifted.distance_m) == (MeasurementStatus.ERROR, None)
    assert "above the horizon" in lifted.reason


def test_the_floor_below_a_box_by_a_network_counts_with_the_feet_that_are_cut(camera: CameraModel) -> None:
    """Of a thing of unknown height 3 m away; 7 % of it are left out at its lower end."""
    ends = [in_camera(x, y, 3.0) for x, y in ((-0.1, -0.1), (0.1, -0.1), (0.1, HEIGHT_M), (-0.1, HEIGHT_M))]
    found = detection_of_corners(np.array([camera.pixel(x / z, y / z) for x, y, z in ends]), sigma_px=0.5)
    unknown = UprightShape(known="height", length_m=0.4, relative_sigma=math.inf)
    sheet = SheetShape(width_m=0.2, height_m=0.4, relative_sigma=math.inf)
    by_box, by_sheet = (stood(found, camera, shape=each) for each in (unknown, sheet))
    assert by_box.distance_m == pytest.approx(math.hypot(3.0, 0.1), rel=0.01)
    assert by_box.sigma_m > by_sheet.sigma_m
    assert by_box.sigma_m / by_box.distance_m == pytest.approx(0.07 * 0.4 / HEIGHT_M, rel=0.35)


def test_what_was_not_found_stays_as_it_is(camera: CameraModel) -> None:
    lost = Detection(target="ball", status=DetectionStatus.NOT_FOUND, reason="no blob")
    both = stood(lost, camera)
    assert both.measurement is both.by_size
    assert both.measurement.reason == "no blob"


# The camera's height and tilt from what lies on the floor.

TAG = TagShape(side_m=TAG_M)
SIGMA_PX = 0.05


def corners_of(drawn: OnFloorScene) -> Detection:
    points = drawn.scene.target.outline_m()
    return detection_of_corners(CAMERA.project(points[:, :2] / points[:, 2:]), SIGMA_PX)


@pytest.mark.parametrize("seed", range(4))
def test_exact_corners_give_the_exact_height_and_tilt(seed: int) -> None:
    drawn = tag_lying(seed, 0.7)
    above = camera_above(corners_of(drawn), TAG, CAMERA)
    assert above.height_m == pytest.approx(drawn.height_m, rel=1e-6)
    assert above.tilt_rad == pytest.approx(drawn.tilt_rad, abs=1e-6)
    assert abs(above.roll_rad) < math.radians(0.5)
    assert 0 < above.tilt_sigma_rad < math.radians(0.3)


def test_a_side_that_is_not_known_well_makes_the_height_unsure_and_not_the_tilt() -> None:
    found = corners_of(tag_lying(0, 0.7))
    sure, unsure = (camera_above(found, TagShape(side_m=TAG_M, relative_sigma=s), CAMERA) for s in (0.0, 0.05))
    assert unsure.height_sigma_m == pytest.approx(math.hypot(sure.height_sigma_m, 0.05 * sure.height_m))
    assert unsure.tilt_sigma_rad == sure.tilt_sigma_rad


def test_a_sheet_of_which_it_is_not_said_how_it_lies_is_taken_as_it_does() -> None:
    drawn = tag_lying(1, 0.8)
    found = corners_of(drawn)
    above = camera_above(found, SheetShape(width_m=TAG_M, height_m=TAG_M), CAMERA)
    assert above.height_m == pytest.approx(drawn.height_m, rel=1e-6)


def test_a_tag_that_is_too_small_is_refused() -> None:
    with pytest.raises(CalibrationError, match="put it nearer"):
        camera_above(corners_of(tag_lying(0, 2.0, 0.02)), TagShape(side_m=0.02), CAMERA)


def test_pictures_that_differ_widen_the_deviation() -> None:
    one = camera_above(corners_of(tag_lying(0, 0.7)), TAG, CAMERA)
    assert mean_of([one, one]).tilt_sigma_rad == one.tilt_sigma_rad
    other = camera_above(corners_of(tag_lying(1, 0.7)), TAG, CAMERA)
    mean = mean_of([one, other])
    assert min(one.tilt_rad, other.tilt_rad) < mean.tilt_rad < max(one.tilt_rad, other.tilt_rad)
    assert mean.tilt_sigma_rad > min(one.tilt_sigma_rad, other.tilt_sigma_rad)
