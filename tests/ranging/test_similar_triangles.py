"""The formula."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.ranging.similar_triangles import distance_m

INCH_M = 0.0254
LENGTHS = st.floats(1e-3, 1e3)


def test_the_worked_example() -> None:
    assert distance_m(541.09, 11 * INCH_M, 170) / INCH_M == pytest.approx(35.0, abs=0.05)


@given(apparent_px=LENGTHS, focal_px=LENGTHS, size_m=LENGTHS)
def test_half_as_large_is_twice_as_far(apparent_px: float, focal_px: float, size_m: float) -> None:
    assert distance_m(focal_px, size_m, apparent_px / 2) == pytest.approx(2 * distance_m(focal_px, size_m, apparent_px))


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
def test_sizes_that_are_none_are_refused(wrong: float) -> None:
    for values in ((wrong, 1.0, 1.0), (1.0, wrong, 1.0), (1.0, 1.0, wrong)):
        with pytest.raises(ValueError, match="is not a finite number above zero"):
            distance_m(*values)
