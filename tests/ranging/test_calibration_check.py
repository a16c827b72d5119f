"""New pictures at known distances say how wrong a camera model is."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.errors import CalibrationError
from stadimeter.ranging.calibration import KnownDistance
from stadimeter.ranging.calibration_check import CalibrationCheck, check_calibration
from stadimeter.ranging.flat import SheetShape

PAPER = SheetShape(width_m=0.297, height_m=0.21)
Seen = Callable[..., Detection]


@pytest.fixture
def known(seen_sheet: Seen) -> Callable[..., KnownDistance]:
    def _known(depth_m: float, stated_m: float | None = None, scale: int = 1) -> KnownDistance:
        seen = seen_sheet(scale * 600 * 0.297 / depth_m, scale * 600 * 0.21 / depth_m, (scale * 320 - 0.5,) * 2)
        return KnownDistance(
            picture=f"{depth_m}.png",
            width_px=640 * scale,
            height_px=480 * scale,
            detection=seen,
            size=PAPER,
            depth_m=stated_m or depth_m,
        )

    return _known


def _check(model: CameraModel, *known: KnownDistance) -> CalibrationCheck:
    return check_calibration(known, model, distance_relative_sigma=0.01)


def test_a_right_camera_file_is_sound(camera: CameraModel, known: Callable[..., KnownDistance]) -> None:
    checked = _check(camera, known(1.0), known(2.0))
    assert checked.is_sound
    assert checked.bias_share == pytest.approx(0, abs=1e-6)


def test_a_focal_length_that_is_too_long_reads_too_far_in_every_picture(
    camera: CameraModel, known: Callable[..., KnownDistance]
) -> None:
    checked = _check(replace(camera, fx_px=642, fy_px=642), *(known(0.5 + 0.25 * i) for i in range(4)))
    assert checked.bias_is_outside
    assert checked.bias_share == pytest.approx(0.07, rel=1e-3)
    assert not checked.is_sound


def test_the_same_error_is_allowed_to_a_camera_file_that_states_it(
    camera: CameraModel, known: Callable[..., KnownDistance]
) -> None:
    unsure = replace(camera, fx_px=642, fy_px=642, focal_relative_sigma=0.05)
    assert _check(unsure, *(known(0.5 + 0.25 * i) for i in range(4))).is_sound


def test_one_wrong_distance_among_right_ones_is_outside_and_the_mean_is_not(
    camera: CameraModel, known: Callable[..., KnownDistance]
) -> None:
    checked = _check(camera, *(known(0.5 + 0.1 * i) for i in range(7)), known(1.0, stated_m=1.045))
    assert [each.is_outside for each in checked.pictures] == [False] * 7 + [True]
    assert not checked.bias_is_outside
    assert not checked.is_sound


def test_pictures_of_another_resolution_are_measured_at_it(
    camera: CameraModel, known: Callable[..., KnownDistance]
) -> None:
    assert _check(camera, known(1.0, scale=2)).pictures[0].measured_m == pytest.approx(1.0, rel=1e-3)


def test_nothing_to_check_with_is_an_error(camera: CameraModel) -> None:
    with pytest.raises(CalibrationError, match="there is no picture to check with"):
        _check(camera)
