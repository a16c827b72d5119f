"""The size of what is seen at a known distance."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.measure import DRAWN_SIGMA_PX, DrawnBox, box_size_at, measure, sigma_parts, size_at


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


def test_a_box_is_as_large_as_similar_triangles_say(camera: CameraModel) -> None:
    box = DrawnBox(camera.cx_px - 60, camera.cy_px - 30, 120, 60)
    size = box_size_at(box, camera, (2.0, 0.0))
    assert (size.width_m, size.height_m) == pytest.approx((0.4, 0.2))
    assert size.width_sigma_m == pytest.approx(math.sqrt(2) * DRAWN_SIGMA_PX / 600 * 2)
    sure, unsure = (box_size_at(box, replace(camera, focal_relative_sigma=s), (2.0, 0.02)) for s in (0.0, 0.03))
    assert sure.width_sigma_m < unsure.width_sigma_m


def test_aside_the_straight_line_is_longer_than_the_depth(camera: CameraModel) -> None:
    middle, aside = (
        DrawnBox(camera.cx_px - 30, camera.cy_px - 30, 60, 60),
        DrawnBox(camera.cx_px + 220, camera.cy_px - 30, 60, 60),
    )
    ahead, beside = (box_size_at(box, camera, (2.0, 0.02)).width_m for box in (middle, aside))
    assert beside == pytest.approx(ahead / math.hypot(1, 250 / 600), rel=1e-3)
