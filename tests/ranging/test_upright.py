"""The shape of an upright thing of one known length."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.ranging.flat import UprightShape
from stadimeter.ranging.measure import measure, sigma_parts

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
BENT = CameraModel(
    width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=319.5, cy_px=239.5, distortion=(-0.2, 0.05, 0.0, 0.0)
)


def seen(camera: CameraModel, ends_m: Any, known: str) -> Detection:
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
    reading = shape.locate(seen(camera, ends_m, known), camera)
    assert reading.position_m == pytest.approx(place_m, rel=0.01, abs=0.03)


@pytest.mark.parametrize("bearing_deg", [0, 15, 25])
def test_eyes_that_look_at_the_camera_are_at_their_distance_beside_the_axis_too(bearing_deg: float) -> None:
    turn = math.radians(bearing_deg)
    middle = np.array((math.sin(turn), 0.0, math.cos(turn))) * 1.2
    across = np.array((math.cos(turn), 0.0, -math.sin(turn))) * 0.0317
    shape = UprightShape(known="eye_distance", length_m=0.0634)
    reading = shape.locate(seen(CAMERA, np.stack((middle - across, middle + across)), "eye_distance"), CAMERA)
    assert math.hypot(*reading.position_m) == pytest.approx(1.2, rel=0.002)
    assert reading.noise_share == pytest.approx(0.04)


def test_the_spread_of_sizes_stays_and_the_noise_of_the_box_does_not() -> None:
    shape = UprightShape(known="height", length_m=1.72, relative_sigma=0.07 / 1.72, box_sigma=0.04)
    measured = measure(seen(CAMERA, [(0, -0.86, 4), (0, 0.86, 4)], "height"), shape, CAMERA, 0.0)
    parts = sigma_parts(measured, shape, CAMERA)
    assert parts.size_m == pytest.approx(4.0 * 0.07 / 1.72)
    assert parts.edges_m == measured.noise_m == pytest.approx(0.04 * 4.0)
    assert parts.pose_m == 0.0


def test_a_shape_says_what_is_known_of_it_and_how_exactly_it_may_be_seen() -> None:
    assert UprightShape(known="height", length_m=1.72).label == "thing with a height of 1.72 m"
    assert UprightShape(known="eye_distance", length_m=0.063).label == "thing with an eye distance of 0.063 m"
    assert UprightShape(known="height", length_m=1.72, box_sigma=0.04).size_sigma_px(200.0) == pytest.approx(8.0)
