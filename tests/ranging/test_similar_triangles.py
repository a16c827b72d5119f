"""The two formulas."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.ranging.similar_triangles import distance_m, focal_length_px

INCH_M = 0.0254
LENGTHS = st.floats(1e-3, 1e3)


def test_the_worked_example() -> None:
    focal_px = focal_length_px(apparent_px=248, distance_m=24 * INCH_M, size_m=11 * INCH_M)
    assert focal_px == pytest.approx(541.09, abs=0.01)
    assert distance_m(focal_px, 11 * INCH_M, 170) / INCH_M == pytest.approx(35.0, abs=0.05)


@given(apparent_px=LENGTHS, away_m=LENGTHS, size_m=LENGTHS)
def test_what_was_calibrated_on_measures_as_far_as_it_was(apparent_px: float, away_m: float, size_m: float) -> None:
    focal_px = focal_length_px(apparent_px, away_m, size_m)
    assert distance_m(focal_px, size_m, apparent_px) == pytest.approx(away_m)


@given(apparent_px=LENGTHS, focal_px=LENGTHS, size_m=LENGTHS)
def test_half_as_large_is_twice_as_far(apparent_px: float, focal_px: float, size_m: float) -> None:
    assert distance_m(focal_px, size_m, apparent_px / 2) == pytest.approx(2 * distance_m(focal_px, size_m, apparent_px))


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
def test_sizes_that_are_none_are_refused(wrong: float) -> None:
    for values in ((wrong, 1.0, 1.0), (1.0, wrong, 1.0), (1.0, 1.0, wrong)):
        with pytest.raises(ValueError, match="is not a finite number above zero"):
            focal_length_px(*values)
        with pytest.raises(ValueError, match="is not a finite number above zero"):
            distance_m(*values)
