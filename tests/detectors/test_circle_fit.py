"""Circles and slightly elliptical outlines through points of which many do not belong to them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.detectors.ball.blobs import find_common_circle

pytestmark = pytest.mark.vision


def _arc(x: float, y: float, radius: float, start: float = 0.0, end: float = 2 * math.pi, count: int = 90):
    angles = np.linspace(start, end, count, endpoint=False)
    return np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])


@given(
    x=st.floats(50, 500),
    y=st.floats(50, 400),
    radius=st.floats(8, 200),
    share=st.floats(0.55, 1.0),
    seed=st.integers(0, 9),
)
def test_the_circle_that_most_points_lie_on_is_found(
    x: float, y: float, radius: float, share: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    points = _arc(x, y, radius, 0.3, 0.3 + share * 2 * math.pi, count=60) + rng.normal(0, 0.05, (60, 2))
    others = rng.uniform((x - radius, y - radius), (x + radius, y + radius), (20, 2))
    found = find_common_circle(np.concatenate([points, others]))
    assert found is not None
    on_it = np.abs(np.hypot(points[:, 0] - found.x_px, points[:, 1] - found.y_px) - found.radius_px) < 1.0
    assert on_it.mean() > 0.7


def test_points_on_a_line_are_no_circle() -> None:
    assert find_common_circle(np.column_stack([np.arange(50.0), np.full(50, 7.0)])) is None
