"""Circles and slightly elliptical outlines through points of which many do not belong to them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.detectors.circle_fit import Circle, RoundOutline, find_circle, fit_outline

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
def test_an_arc_gives_its_circle_back(x: float, y: float, radius: float, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = _arc(x, y, radius, 0.3, 0.3 + share * 2 * math.pi) + rng.normal(0, 0.05, (90, 2))
    start = RoundOutline.of(Circle(x_px=x + 0.03 * radius, y_px=y - 0.03 * radius, radius_px=1.03 * radius))
    fitted = fit_outline(points, start, 1.5, 0.1)
    assert fitted is not None
    assert fitted.circle.radius_px == pytest.approx(radius, abs=0.25 + 0.01 * radius)
    assert fitted.coverage == pytest.approx(share, abs=0.1)


@given(ellipticity=st.floats(0.0, 0.12), degrees=st.floats(0, 360))
def test_the_smaller_diameter_of_an_ellipse_is_read_across_its_long_axis(ellipticity: float, degrees: float) -> None:
    tilt = math.radians(degrees)
    angles = np.linspace(0, 2 * math.pi, 96, endpoint=False)
    long, short = 50 * (1 + ellipticity), 50 * (1 - ellipticity)
    ellipse = np.column_stack([long * np.cos(angles), short * np.sin(angles)])
    turn = np.array([[math.cos(tilt), math.sin(tilt)], [-math.sin(tilt), math.cos(tilt)]])
    start = RoundOutline.of(Circle(x_px=300, y_px=200, radius_px=50))
    fitted = fit_outline(ellipse @ turn + (300, 200), start, 1.5, 0.15)
    assert fitted is not None
    across = fitted.diameter_across_px((math.cos(tilt), math.sin(tilt)))
    assert across == pytest.approx(2 * short, rel=0.004)
    assert fitted.diameter_across_px((0.0, 0.0)) == pytest.approx(100, rel=0.004)


def test_a_circle_is_found_among_twice_as_many_other_points() -> None:
    rng = np.random.default_rng(3)
    circle = _arc(200, 150, 40, count=80)
    clutter = rng.uniform((120, 70), (280, 230), (160, 2))
    points = np.concatenate([circle, clutter])
    found = find_circle(points, np.ones(len(points)), circle[::8], math.pi * 40**2, (1.5, 0.03))
    assert found is not None
    assert (found.x_px, found.y_px, found.radius_px) == pytest.approx((200, 150, 40), abs=1.5)


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.ones((5, 2)), np.ones((50, 2)), _arc(0, 0, 10)[:5]])
def test_too_little_is_no_circle(points: np.ndarray) -> None:
    assert find_circle(points, np.ones(len(points)), np.zeros((1, 2)), 100.0, (1.5, 0.05)) is None


def test_points_on_a_line_are_no_circle() -> None:
    line = np.column_stack([np.arange(50.0), np.full(50, 7.0)])
    assert find_circle(line, np.ones(50), line, 100.0, (1.5, 0.05)) is None
    start = RoundOutline.of(Circle(x_px=25, y_px=500, radius_px=5))
    assert fit_outline(line, start, 1.5, 0.05) is None
