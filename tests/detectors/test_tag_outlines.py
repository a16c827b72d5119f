"""Outlines of tags: what was found twice counts once, however many there are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.detectors.tag.search import SAME_PX, distinct

pytestmark = pytest.mark.vision

SQUARE = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])


@given(seed=st.integers(0, 10_000), count=st.integers(1, 60), spread_px=st.sampled_from([1.0, 5.0, 200.0]))
def test_an_outline_is_left_unless_an_earlier_one_is_the_same(seed: int, count: int, spread_px: float) -> None:
    rng = np.random.default_rng(seed)
    outlines = SQUARE + rng.uniform(0, spread_px, (count, 1, 2)) + rng.normal(0, 0.4, (count, 4, 2))
    left = [
        each
        for number, each in enumerate(outlines)
        if not any(np.abs(each - earlier).max() < SAME_PX for earlier in outlines[:number])
    ]
    assert np.array_equal(distinct(outlines), left)


@pytest.mark.long
def test_a_chequered_floor_has_tens_of_thousands_of_outlines_and_each_counts_once() -> None:
    places = np.stack(np.meshgrid(np.arange(200.0), np.arange(200.0)), axis=-1).reshape(-1, 1, 2) * 20
    floor = SQUARE + places
    assert np.array_equal(distinct(np.concatenate([floor, floor + 0.5])), floor)
