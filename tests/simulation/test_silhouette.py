from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.camera_model import CameraModel
from stadimeter.simulation.silhouette import hits, silhouette

LENS = CameraModel.with_focal_length(600.0, 640, 480)
OBLONG = CameraModel(width_px=640, height_px=480, fx_px=500.0, fy_px=700.0, cx_px=300.0, cy_px=260.0)
ANGLES = np.linspace(0, 2 * math.pi, 40, endpoint=False)
CIRCLE = np.stack((np.cos(ANGLES), np.sin(ANGLES)), axis=1)

balls = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.5, 10))
radii = st.floats(0.01, 0.3)
lenses = st.sampled_from([LENS, OBLONG])


def test_a_ball_on_the_axis_is_a_circle_of_the_cones_size() -> None:
    seen = silhouette(LENS, (0.0, 0.0, 2.0), 0.1)
    expected_px = 600 * math.tan(math.asin(0.1 / 2.0))
    assert seen is not None
    assert seen.centre_px == (LENS.cx_px, LENS.cy_px)
    assert seen.half_across_px == pytest.approx((expected_px, expected_px))
    assert seen.half_along_px == pytest.approx((expected_px, expected_px))


@given(lens=lenses, ball=balls, radius=radii)
def test_the_rays_through_the_outline_touch_the_ball(
    lens: CameraModel, ball: tuple[float, float, float], radius: float
) -> None:
    seen = silhouette(lens, ball, radius)
    assert seen is not None
    for x_px, y_px in seen.outline_px(CIRCLE):
        ray = np.array((*lens.direction(x_px, y_px), 1.0))
        nearest_m = np.linalg.norm(np.cross(ray / np.linalg.norm(ray), ball))
        assert nearest_m == pytest.approx(radius, rel=1e-6)


@given(lens=lenses, ball=balls, radius=radii)
def test_the_extent_is_that_of_the_outline(lens: CameraModel, ball: tuple[float, float, float], radius: float) -> None:
    seen = silhouette(lens, ball, radius)
    assert seen is not None
    fine = np.linspace(0, 2 * math.pi, 4000)
    outline = seen.outline_px(np.stack((np.cos(fine), np.sin(fine)), axis=1))
    size_px = max(seen.half_along_px)
    assert (*outline.min(axis=0), *outline.max(axis=0)) == pytest.approx(seen.extent_px, abs=1e-5 * size_px)


@given(ball=balls, radius=radii)
def test_the_minor_axis_gives_the_depth_by_similar_triangles_but_for_the_radius(
    ball: tuple[float, float, float], radius: float
) -> None:
    seen = silhouette(LENS, ball, radius)
    assert seen is not None
    assert math.hypot(600 * radius / seen.half_across_px[0], radius) == pytest.approx(ball[2])


@given(lens=lenses, ball=balls, radius=radii)
def test_a_ray_hits_inside_the_outline_and_misses_outside(
    lens: CameraModel, ball: tuple[float, float, float], radius: float
) -> None:
    seen = silhouette(lens, ball, radius)
    assert seen is not None
    assert all(hits(lens.direction(*point), ball, radius) for point in seen.outline_px(CIRCLE, 0.999))
    assert not any(hits(lens.direction(*point), ball, radius) for point in seen.outline_px(CIRCLE, 1.001))


@pytest.mark.parametrize("depth_m", [-3.0, 0.0, 0.05, 0.1])
def test_a_ball_not_wholly_in_front_has_no_ellipse(depth_m: float) -> None:
    assert silhouette(LENS, (0.3, 0.0, depth_m), 0.1) is None


def test_a_ball_behind_is_not_hit() -> None:
    assert not hits((0.0, 0.0), (0.0, 0.0, -2.0), 0.1)
