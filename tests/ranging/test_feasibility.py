"""What a camera and a target can do at a distance is known before anything is bought."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, TargetShape
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import CirclesShape, SheetShape
from stadimeter.ranging.similar_triangles import expect, farthest_m

TENNIS = BallShape(diameter_m=0.067)
PAPER = SheetShape(width_m=0.297, height_m=0.21)
CAMERA = CameraModel.with_focal_length(600.0, 640, 480)


def test_a_tennis_ball_at_ten_metres_is_four_pixels_wide() -> None:
    expected = expect(TENNIS, CAMERA, 10.0)
    assert expected.size_px == pytest.approx(4.02, abs=0.01)
    assert expected.sigma_m == pytest.approx(10 * (0.85 / 2.01) / 4.02, rel=0.02)
    assert not expected.is_reliable


def test_three_circles_are_as_large_as_one_of_them() -> None:
    mark = CirclesShape(diameter_m=0.05, spacing_m=0.1)
    assert expect(mark, CAMERA, 3.0).size_px == pytest.approx(10.0, rel=1e-3), "each disc must be found"


def test_a_sheet_is_as_small_as_its_shorter_side() -> None:
    assert expect(PAPER, CAMERA, 2.0).size_px == pytest.approx(63.0)


def test_a_ball_appears_as_large_as_its_outline(seen_ball: Callable[..., Detection]) -> None:
    seen = seen_ball((0.0, 0.0, 0.3), 0.1)
    assert expect(BallShape(diameter_m=0.2), CAMERA, 0.3).size_px == pytest.approx(seen.width_px, rel=1e-3)


@given(size=st.sampled_from([TENNIS, PAPER]), distance_m=st.floats(0.3, 20.0))
def test_further_away_is_smaller_and_less_sure(size: TargetShape, distance_m: float) -> None:
    near, far = expect(size, CAMERA, distance_m), expect(size, CAMERA, 1.5 * distance_m)
    assert far.size_px < near.size_px
    assert far.sigma_m > 2 * near.sigma_m


@given(size=st.sampled_from([TENNIS, PAPER]), size_px=st.floats(5, 200))
def test_the_farthest_distance_is_where_the_size_is_reached(size: TargetShape, size_px: float) -> None:
    assert expect(size, CAMERA, farthest_m(size, CAMERA, size_px)).size_px == pytest.approx(size_px)


def test_an_unsure_focal_length_makes_the_distance_unsure_but_not_noisy() -> None:
    unsure = replace(CAMERA, focal_relative_sigma=0.1)
    expected = expect(PAPER, unsure, 2.0)
    assert expected.sigma_m == pytest.approx(0.2, rel=0.01)
    assert expected.noise_m == expect(PAPER, CAMERA, 2.0).noise_m == expect(PAPER, CAMERA, 2.0).sigma_m


@pytest.mark.parametrize("distance_m", [0.0, -1.0, math.nan, math.inf])
def test_a_distance_that_is_none_is_refused(distance_m: float) -> None:
    with pytest.raises(ValueError, match="is not a finite number above zero"):
        expect(TENNIS, CAMERA, distance_m)
