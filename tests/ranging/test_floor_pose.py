"""The camera's height and tilt from what lies on the floor."""

from __future__ import annotations

import math

import pytest

from stadimeter.core.detection import Detection
from stadimeter.errors import CalibrationError
from stadimeter.ranging.flat import SheetShape, TagShape
from stadimeter.ranging.floor import camera_above, mean_of
from support.corners import detection_of_corners
from support.scenes.draw import CAMERA, TAG_M
from support.scenes.on_floor import OnFloorScene, tag_lying

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
