"""What a standard deviation is made up of."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.measure import measure, sigma_parts

pytestmark = pytest.mark.vision

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


def test_a_cause_that_is_not_there_is_exactly_zero() -> None:
    camera = replace(CAMERA, focal_relative_sigma=0.0123)
    size = BallShape(diameter_m=0.1)
    parts = sigma_parts(measure(SEEN, size, camera, 0.0), size, camera)
    assert parts is not None
    assert parts.pose_m == 0.0
    assert parts.size_m == 0.0


def test_what_is_left_is_the_pose() -> None:
    measured = Measurement(
        target="tag", status=MeasurementStatus.MEASURED, captured_at_s=0.0, distance_m=1.0, sigma_m=0.05, noise_m=0.03
    )
    parts = sigma_parts(measured, BallShape(diameter_m=0.1), CAMERA)
    assert parts is not None
    assert parts.pose_m == pytest.approx(0.04)


def test_without_a_distance_there_is_nothing_to_divide() -> None:
    missed = Measurement(target="ball", status=MeasurementStatus.NOT_FOUND, captured_at_s=0.0, reason="no blob")
    assert sigma_parts(missed, BallShape(diameter_m=0.1), CAMERA) is None
