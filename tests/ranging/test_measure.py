"""From a detection to a distance, a size and a separation, and how sure they are."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel, LensUncertainty
from stadimeter.core.detection import Detection, DetectionStatus, TargetShape
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import SheetShape, TagShape, UprightShape
from stadimeter.ranging.measure import SeenTarget, direction_sigmas_rad, measure, separation, sigma_parts, size_at
from stadimeter.ranging.plane_pose import rectangle
from stadimeter.ranging.similar_triangles import distance_m, expect, farthest_m
from support.corners import detection_of_corners

pytestmark = pytest.mark.vision


# From a detection to a distance.

LETTER = SheetShape(width_m=0.2794, height_m=0.2159)
Seen = Callable[..., Detection]

POSITIONS = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.4, 0.4), st.floats(0.3, 8.0)).map(
    lambda p: (p[0] * p[2], p[1] * p[2], p[2])
)


@given(position_m=POSITIONS, radius_m=st.floats(0.01, 0.12))
def test_a_ball_is_measured_exactly_anywhere_in_the_picture(
    camera: CameraModel, seen_ball: Seen, position_m: tuple[float, float, float], radius_m: float
) -> None:
    measured = measure(seen_ball(position_m, radius_m), BallShape(diameter_m=2 * radius_m), camera, 1.5)
    assert measured.status is MeasurementStatus.MEASURED
    assert measured.depth_m == pytest.approx(position_m[2], rel=1e-4)
    assert measured.distance_m == pytest.approx(math.hypot(*position_m), rel=1e-4)
    assert measured.position_m == pytest.approx(position_m, rel=1e-3, abs=1e-3)
    assert (measured.target, measured.captured_at_s, measured.reason) == ("ball", 1.5, "")


@given(x=st.floats(-200, 840), y=st.floats(-100, 580), width_px=st.floats(20, 400))
def test_a_sheet_facing_the_camera_is_where_it_appears(
    camera: CameraModel, seen_sheet: Seen, x: float, y: float, width_px: float
) -> None:
    seen = seen_sheet(width_px, width_px * 8.5 / 11, (x, y))
    measured = measure(seen, LETTER, camera, 0.0)
    depth_m = LETTER.width_m * camera.fx_px / width_px
    expected = (depth_m * (x - camera.cx_px) / camera.fx_px, depth_m * (y - camera.cy_px) / camera.fy_px, depth_m)
    assert measured.position_m == pytest.approx(expected)
    assert measured.distance_m == pytest.approx(math.hypot(*expected))
    assert measured.depth_m <= measured.distance_m


def test_what_is_perhaps_the_target_has_its_figures_and_the_doubt(camera: CameraModel, seen_sheet: Seen) -> None:
    sure = measure(seen_sheet(110, 85, (319.5, 239.5)), LETTER, camera, 0.0)
    seen = replace(seen_sheet(110, 85, (319.5, 239.5)), status=DetectionStatus.PERHAPS, reason="a pale rim")
    assert measure(seen, LETTER, camera, 0.0) == replace(sure, status=MeasurementStatus.PERHAPS, reason="a pale rim")


def test_bearings_are_positive_to_the_right_and_elevations_upwards(camera: CameraModel, seen_sheet: Seen) -> None:
    right_and_up = measure(seen_sheet(110, 85, (619.5, 39.5)), LETTER, camera, 0.0)
    assert right_and_up.bearing_rad == pytest.approx(math.atan(0.5))
    assert right_and_up.elevation_rad == pytest.approx(math.atan2(1 / 3, math.hypot(1, 0.5)))


def test_edges_that_all_lie_too_far_out_are_no_noise_and_more_where_colour_is_subsampled(
    camera: CameraModel, seen_sheet: Seen
) -> None:
    seen = seen_sheet(110, 85, (319.5, 239.5))
    plain = measure(seen, LETTER, camera, 0.0)
    smeared = measure(seen, LETTER, replace(camera, subsampling="4:2:0"), 0.0)
    assert plain.noise_m == smeared.noise_m
    assert plain.noise_m < plain.sigma_m < smeared.sigma_m


def test_the_focal_lengths_uncertainty_is_added_in_quadrature_and_is_no_noise(
    camera: CameraModel, seen_sheet: Seen
) -> None:
    seen = seen_sheet(100, 77.2, (319.5, 239.5), sigma_px=1.0)
    measured = measure(seen, LETTER, replace(camera, focal_relative_sigma=0.02), 0.0)
    assert measured.noise_m == pytest.approx(0.01 * measured.distance_m, rel=1e-3)
    assert measured.sigma_m == pytest.approx(math.hypot(0.01, 0.02) * measured.distance_m, rel=1e-3)


def test_auto_does_not_care_how_the_sheet_hangs(camera: CameraModel, seen_sheet: Seen) -> None:
    centre = (319.5, 239.5)
    landscape = measure(seen_sheet(220, 170, centre), LETTER, camera, 0.0)
    portrait = measure(seen_sheet(170, 220, centre), LETTER, camera, 0.0)
    assert portrait.depth_m == landscape.depth_m


def test_a_named_side_is_the_one_that_is_used(camera: CameraModel, seen_sheet: Seen) -> None:
    seen = seen_sheet(170, 220, (319.5, 239.5))
    by_width = measure(seen, replace(LETTER, known_side="width"), camera, 0.0)
    by_height = measure(seen, replace(LETTER, known_side="height"), camera, 0.0)
    assert by_width.depth_m == pytest.approx(0.2794 * 600 / 170)
    assert by_height.depth_m == pytest.approx(0.2159 * 600 / 220)


def test_pixels_that_are_not_square_are_allowed_for(seen_sheet: Seen) -> None:
    camera = CameraModel(width_px=640, height_px=480, fx_px=600, fy_px=300, cx_px=319.5, cy_px=239.5)
    measured = measure(seen_sheet(220, 85, (319.5, 239.5)), LETTER, camera, 0.0)
    assert measured.depth_m == pytest.approx(0.2794 * 600 / 220, rel=1e-3)


@pytest.mark.parametrize("status", [DetectionStatus.TRUNCATED, DetectionStatus.NOT_FOUND])
def test_what_was_not_found_whole_has_no_figures(camera: CameraModel, status: DetectionStatus) -> None:
    seen = Detection(target="ball", status=status, reason="largest blob 6 px, limit 12 px", width_px=80, height_px=80)
    measured = measure(seen, BallShape(diameter_m=0.064), camera, 2.0)
    assert measured.status.value == status.value
    assert measured.reason == "largest blob 6 px, limit 12 px"
    assert measured.captured_at_s == 2.0
    figures = (measured.distance_m, measured.depth_m, measured.sigma_m, measured.noise_m, measured.bearing_rad)
    assert figures == (None,) * 5
    assert measured.position_m is None


def test_a_detector_that_reports_no_size_is_an_error_not_a_distance(camera: CameraModel, seen_sheet: Seen) -> None:
    for size in (0.0, -3.0, math.nan):
        measured = measure(seen_sheet(size, size, (10, 10)), LETTER, camera, 0.0)
        assert measured.status is MeasurementStatus.ERROR
        assert measured.distance_m is None


@given(sigma_px=st.floats(0.01, 0.5), width_px=st.floats(20, 400))
def test_an_edge_bias_that_is_not_known_counts_at_both_edges_and_is_no_noise(
    camera: CameraModel, seen_sheet: Seen, sigma_px: float, width_px: float
) -> None:
    seen = seen_sheet(width_px, width_px * 8.5 / 11, (320.0, 240.0))
    known, unknown = (measure(seen, LETTER, replace(camera, edge_bias_sigma_px=each), 0.0) for each in (0.0, sigma_px))
    assert unknown.distance_m == known.distance_m
    assert unknown.noise_m == known.noise_m
    added_m = math.sqrt(unknown.sigma_m**2 - known.sigma_m**2)
    assert added_m == pytest.approx(2 * sigma_px / width_px * known.distance_m, rel=1e-3)


# The formula.


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
def test_sizes_that_are_none_are_refused(wrong: float) -> None:
    for values in ((wrong, 1.0, 1.0), (1.0, wrong, 1.0), (1.0, 1.0, wrong)):
        with pytest.raises(ValueError, match="is not a finite number above zero"):
            distance_m(*values)


# The size of what is seen at a known distance.


@pytest.mark.parametrize("taken_for_m", [0.05, 0.2])
def test_a_ball_has_its_true_size_whatever_it_is_taken_for(
    taken_for_m: float, seen_ball: Callable[..., Detection], camera: CameraModel
) -> None:
    found = seen_ball((0.3, 0.1, 1.5), 0.06, sigma_px=0.3)
    shape = BallShape(diameter_m=taken_for_m, relative_sigma=0.5)
    known = replace(camera, focal_relative_sigma=0.01)
    measured = measure(found, shape, known, 0.0)
    parts = sigma_parts(measured, shape, known)
    assert parts is not None
    size = size_at(measured, parts, shape, False, (math.hypot(0.3, 0.1, 1.5), 0.03))
    assert size is not None
    assert size.width_m == size.height_m == pytest.approx(0.12, rel=1e-3)
    edges = 0.3 / found.width_px
    assert size.width_sigma_m / size.width_m == pytest.approx(math.hypot(0.01, 0.03 / 1.533, edges), rel=0.02)


# How far two targets are apart, and how sure that and their directions are.

LENS = CameraModel(
    width_px=640,
    height_px=480,
    fx_px=612.0,
    fy_px=610.0,
    cx_px=315.0,
    cy_px=246.0,
    distortion=(-0.2, 0.06, 0.001, -0.0005, 0.0),
)
TAG = TagShape(side_m=0.08, relative_sigma=0.01)
SIGMA_PX = 0.1
PLACES_M = np.array(((-0.25, -0.1, 0.8), (0.3, 0.15, 1.1)))


def seen_tag(place_m: np.ndarray, model: CameraModel, rng: np.random.Generator, side_m: float = 0.08) -> SeenTarget:
    """Return a tag that is seen through `LENS` with noise, and measured through another model."""
    turn, _ = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))
    there = (rectangle(side_m, side_m) * (1, -1, 1)) @ turn.T + place_m
    corners_px = LENS.project(there[:, :2] / there[:, 2:]) + rng.normal(0, SIGMA_PX / np.sqrt(2), (4, 2))
    found = detection_of_corners(corners_px, SIGMA_PX, "tag")
    return SeenTarget(detection=found, measurement=measure(found, TAG, model, 0.0), shape=TAG)


def wrong_lens(rng: np.random.Generator) -> CameraModel:
    """Return a model that errs as its uncertainty says."""
    sigmas = (4.0, 4.0, 2.0, 2.0, 0.01, 0.02, 0.001, 0.001, 0.0)
    correlations = (0.9, *(0.0,) * 35)  # of fx and fy
    uncertainty = LensUncertainty(sigmas=sigmas, correlations=correlations)
    off = rng.multivariate_normal(np.zeros(9), uncertainty.covariance())
    fx, fy, cx, cy = np.array([LENS.fx_px, LENS.fy_px, LENS.cx_px, LENS.cy_px]) + off[:4]
    distortion = tuple(float(each) for each in np.array(LENS.distortion) + off[4:])
    return replace(LENS, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=distortion, uncertainty=uncertainty)


def test_the_interval_of_a_separation_holds() -> None:
    true_m = float(np.linalg.norm(PLACES_M[1] - PLACES_M[0]))
    missed = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        model = wrong_lens(rng)
        side_m = 0.08 * (1 + rng.normal(0, 0.01))  # of both: they are printed alike
        found = separation(*(seen_tag(place_m, model, rng, side_m) for place_m in PLACES_M), model)
        assert found is not None
        missed.append((found.distance_m - true_m) / found.sigma_m)
    inside = np.mean(np.abs(missed) < 1.96)
    assert 0.91 <= inside <= 0.99
    assert 0.8 < np.std(missed) < 1.25


def test_the_intervals_of_a_direction_hold() -> None:
    x, y, z = PLACES_M[1]
    true = np.array((np.arctan2(x, z), -np.arctan2(y, np.hypot(x, z))))
    missed = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        model = wrong_lens(rng)
        target = seen_tag(PLACES_M[1], model, rng)
        sigmas = direction_sigmas_rad(target, model)
        assert sigmas is not None
        measured = np.array((target.measurement.bearing_rad, target.measurement.elevation_rad))
        missed.append((measured - true) / sigmas)
    assert all(0.9 <= share <= 0.99 for share in (np.abs(missed) < 1.96).mean(axis=0))


def test_a_common_error_of_the_focal_length_hardly_moves_targets_beside_each_other() -> None:
    rng = np.random.default_rng(1)
    model = replace(LENS, focal_relative_sigma=0.05)
    beside = [seen_tag(np.array((x_m, 0.0, 1.0)), model, rng) for x_m in (-0.2, 0.2)]
    behind = [seen_tag(np.array((0.0, 0.0, z_m)), model, rng) for z_m in (0.6, 1.0)]
    shares = [found.sigma_m / found.distance_m for pair in (beside, behind) if (found := separation(*pair, model))]
    assert shares[0] < 0.02
    assert shares[1] == pytest.approx(0.05, abs=0.015)


# What a standard deviation is made up of.

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
SEEN = Detection(
    target="ball",
    status=DetectionStatus.FOUND,
    centre_px=(300.0, 200.0),
    width_px=40.0,
    height_px=40.0,
    size_sigma_px=0.1,
)


@given(noise_px=st.floats(0.001, 2.0), focal_share=st.floats(0.0, 0.1), size_share=st.floats(0.0, 0.1))
def test_the_squares_of_the_parts_add_up_to_the_square_of_the_whole(
    noise_px: float, focal_share: float, size_share: float
) -> None:
    camera = replace(CAMERA, focal_relative_sigma=focal_share)
    size = BallShape(diameter_m=0.1, relative_sigma=size_share)
    measured = measure(replace(SEEN, size_sigma_px=noise_px), size, camera, 0.0)
    parts = sigma_parts(measured, size, camera)
    assert parts is not None
    whole_m = math.hypot(parts.edges_m, parts.focal_length_m, parts.size_m, parts.pose_m)
    assert whole_m == pytest.approx(measured.sigma_m)
    assert parts.focal_length_m == pytest.approx(focal_share * measured.distance_m)
    assert parts.size_m == pytest.approx(size_share * measured.distance_m)


# What a camera and a target can do at a distance is known before anything is bought.

TENNIS = BallShape(diameter_m=0.067)
PAPER = SheetShape(width_m=0.297, height_m=0.21)


def test_a_tennis_ball_at_ten_metres_is_four_pixels_wide() -> None:
    expected = expect(TENNIS, CAMERA, 10.0)
    assert expected.size_px == pytest.approx(4.02, abs=0.01)
    assert expected.sigma_m == pytest.approx(10 * (0.85 / 2.01) / 4.02, rel=0.02)
    assert not expected.is_reliable


@given(size=st.sampled_from([TENNIS, PAPER]), size_px=st.floats(5, 200))
def test_the_farthest_distance_is_where_the_size_is_reached(size: TargetShape, size_px: float) -> None:
    assert expect(size, CAMERA, farthest_m(size, CAMERA, size_px)).size_px == pytest.approx(size_px)


@pytest.mark.parametrize("distance_m", [0.0, -1.0, math.nan, math.inf])
def test_a_distance_that_is_none_is_refused(distance_m: float) -> None:
    with pytest.raises(ValueError, match="is not a finite number above zero"):
        expect(TENNIS, CAMERA, distance_m)


# The shape of an upright thing of one known length.

BENT = CameraModel(
    width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=319.5, cy_px=239.5, distortion=(-0.2, 0.05, 0.0, 0.0)
)


def seen_length(camera: CameraModel, ends_m: Any, known: str) -> Detection:
    """Return the detection of a length whose ends are at two places in the camera frame."""
    ends = np.array(ends_m, np.float64)
    (x, y), (other_x, other_y) = camera.project(ends[:, :2] / ends[:, 2:])
    long_px = math.hypot(other_x - x, other_y - y)
    return Detection(
        target="it",
        status=DetectionStatus.FOUND,
        centre_px=((x + other_x) / 2, (y + other_y) / 2),
        width_px=long_px if known != "height" else long_px / 3,
        height_px=long_px if known == "height" else long_px / 3,
        size_sigma_px=0.04 * long_px,
    )


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize("place_m", [(0.0, 0.0, 4.0), (1.5, 0.3, 4.0), (-1.8, -0.2, 5.0)])
@pytest.mark.parametrize(("known", "length_m"), [("height", 1.72), ("width", 0.5)])
def test_a_length_square_to_the_axis_is_exact_anywhere_in_the_picture(
    camera: CameraModel, place_m: tuple[float, float, float], known: str, length_m: float
) -> None:
    half = np.array((0.0, length_m / 2, 0.0) if known == "height" else (length_m / 2, 0.0, 0.0))
    ends_m = np.array(place_m) + np.stack((-half, half))
    shape = UprightShape(known=known, length_m=length_m)
    reading = shape.locate(seen_length(camera, ends_m, known), camera)
    assert reading.position_m == pytest.approx(place_m, rel=0.01, abs=0.03)


@pytest.mark.parametrize("bearing_deg", [0, 15, 25])
def test_eyes_that_look_at_the_camera_are_at_their_distance_beside_the_axis_too(bearing_deg: float) -> None:
    turn = math.radians(bearing_deg)
    middle = np.array((math.sin(turn), 0.0, math.cos(turn))) * 1.2
    across = np.array((math.cos(turn), 0.0, -math.sin(turn))) * 0.0317
    shape = UprightShape(known="eye_distance", length_m=0.0634)
    reading = shape.locate(seen_length(CAMERA, np.stack((middle - across, middle + across)), "eye_distance"), CAMERA)
    assert math.hypot(*reading.position_m) == pytest.approx(1.2, rel=0.002)
    assert reading.noise_share == pytest.approx(0.04)


def test_the_spread_of_sizes_stays_and_so_does_half_of_the_variance_of_a_box() -> None:
    shape = UprightShape(known="height", length_m=1.72, relative_sigma=0.07 / 1.72, box_sigma=0.04)
    measured = measure(seen_length(CAMERA, [(0, -0.86, 4), (0, 0.86, 4)], "height"), shape, CAMERA, 0.0)
    parts = sigma_parts(measured, shape, CAMERA)
    assert parts.size_m == pytest.approx(4.0 * 0.07 / 1.72)
    assert parts.edges_m == measured.noise_m == pytest.approx(0.04 * 4.0)
    assert parts.pose_m == pytest.approx(0.04 * 4.0 / math.sqrt(2))


def test_a_shape_says_what_is_known_of_it_and_how_exactly_it_may_be_seen() -> None:
    assert UprightShape(known="height", length_m=1.72).label == "thing with a height of 1.72 m"
    assert UprightShape(known="eye_distance", length_m=0.063).label == "thing with an eye distance of 0.063 m"
    assert UprightShape(known="height", length_m=1.72, box_sigma=0.04).size_sigma_px(200.0) == pytest.approx(8.0)
