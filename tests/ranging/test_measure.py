"""From a detection to a distance."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.measure import measure

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


@given(nearer=st.floats(21, 400), factor=st.floats(1.01, 5.0))
def test_what_appears_smaller_is_further(camera: CameraModel, seen_sheet: Seen, nearer: float, factor: float) -> None:
    near = measure(seen_sheet(nearer, nearer * 0.7, (319.5, 239.5)), LETTER, camera, 0.0)
    far = measure(seen_sheet(nearer / factor, nearer / factor * 0.7, (319.5, 239.5)), LETTER, camera, 0.0)
    assert far.distance_m == pytest.approx(near.distance_m * factor)
    assert far.noise_m == pytest.approx(near.noise_m * factor**2)


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


def test_auto_takes_the_side_that_is_turned_away_the_least(camera: CameraModel, seen_sheet: Seen) -> None:
    centre = (319.5, 239.5)
    true_m = 0.2794 * 600 / 220
    for shortened in ((220 * 0.9, 170), (220, 170 * 0.8)):
        assert measure(seen_sheet(*shortened, centre), LETTER, camera, 0.0).depth_m == pytest.approx(true_m, rel=1e-3)


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
