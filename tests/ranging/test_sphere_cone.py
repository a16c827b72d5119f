"""The cone around a sphere, from rays that touch it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stadimeter.core.detection import Points
from stadimeter.ranging.ball import ConeFrame, SphereCone, fit_cone, with_ones

pytestmark = pytest.mark.vision

SPHERES = {
    "x": st.floats(-0.6, 0.6),
    "y": st.floats(-0.6, 0.6),
    "share": st.floats(0.002, 0.4),
    "first_rad": st.floats(0, 2 * math.pi),
    "arc_rad": st.floats(1.5, 2 * math.pi),
}


def _rays(x: float, y: float, half_angle_rad: float | Points, angles_rad: Points) -> Points:
    """Return where rays at an angle about an axis look to, x and y per unit of depth."""
    axis = np.array((x, y, 1.0)) / math.sqrt(x * x + y * y + 1)
    first = np.cross(axis, (0.0, 1.0, 0.0))
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    around = np.cos(angles_rad)[:, None] * first + np.sin(angles_rad)[:, None] * second
    half = np.broadcast_to(half_angle_rad, angles_rad.shape)[:, None]
    rays = np.cos(half) * axis + np.sin(half) * around
    return rays[:, :2] / rays[:, 2:]


@given(**SPHERES)
def test_any_arc_of_the_outline_gives_the_sphere_back_exactly(
    x: float, y: float, share: float, first_rad: float, arc_rad: float
) -> None:
    rays = _rays(x, y, math.asin(share), np.linspace(first_rad, first_rad + arc_rad, 24))
    cone = fit_cone(rays, (x + 0.3 * share, y - 0.2 * share))
    assert cone is not None
    assert cone.distance_m(0.03) == pytest.approx(0.03 / share, rel=1e-6)
    length = math.sqrt(x * x + y * y + 1)
    assert cone.axis == pytest.approx((x / length, y / length, 1 / length), abs=1e-7)


@given(**SPHERES)
def test_rays_off_the_cone_are_told_by_how_much(
    x: float, y: float, share: float, first_rad: float, arc_rad: float
) -> None:
    half_rad = math.asin(share)
    angles = np.linspace(first_rad, first_rad + arc_rad, 20)
    off_rad = 1e-4 * half_rad * np.sin(7 * angles)
    frame = ConeFrame(with_ones(_rays(x, y, half_rad + off_rad, angles)), (x, y))
    exact = fit_cone(_rays(x, y, half_rad, angles), (x, y))
    assert exact is not None
    assert frame.misses(exact) == pytest.approx(off_rad, abs=0.01 * 1e-4 * half_rad)


def test_the_standard_deviation_is_that_of_many_tries() -> None:
    rng = np.random.default_rng(1)
    angles, half_rad, noise_rad = np.linspace(0.2, 3.5, 40), 0.05, 2e-4
    sines, shares = [], []
    for _ in range(400):
        rays = with_ones(_rays(0.3, -0.2, half_rad + rng.normal(0, noise_rad, 40), angles))
        cone = ConeFrame(rays, (0.3, -0.2)).fit()
        assert cone is not None
        sines.append(cone.sine)
        shares.append(cone.sine_share)
    assert np.std(sines) / math.sin(half_rad) == pytest.approx(noise_rad * np.mean(shares), rel=0.12)


@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5), share=st.floats(0.01, 0.4))
def test_the_outline_is_the_ellipse_that_the_rays_draw(x: float, y: float, share: float) -> None:
    rays = _rays(x, y, math.asin(share), np.linspace(0, 2 * math.pi, 720, endpoint=False))
    cone = fit_cone(rays, (x, y))
    assert cone is not None
    assert cone.outline_centre == pytest.approx((rays.min(axis=0) + rays.max(axis=0)) / 2, abs=1e-4)
    reach = np.hypot(*(rays - cone.outline_centre).T)
    assert cone.half_across == pytest.approx(reach.min(), rel=1e-3)


def test_too_few_rays_and_rays_that_form_no_cone_are_refused() -> None:
    assert fit_cone(np.zeros((5, 2)), (0.0, 0.0)) is None
    assert fit_cone(np.zeros((20, 2)), (0.0, 0.0)) is None
    along_a_line = np.column_stack([np.linspace(-0.1, 0.1, 20), np.zeros(20)])
    assert fit_cone(along_a_line, (0.0, 0.0)) is None


def test_a_sphere_beside_the_camera_has_no_outline() -> None:
    assert math.isinf(SphereCone(axis=(0.995, 0.0, 0.1), sine=0.5, sine_share=1.0).half_across)


@given(
    rays=arrays(
        np.float64, st.tuples(st.integers(6, 20), st.just(2)), elements=st.floats(-1e6, 1e6, allow_subnormal=False)
    ),
    towards=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
)
def test_whatever_the_rays_there_is_a_cone_with_a_distance_or_none(rays: Points, towards: tuple[float, float]) -> None:
    with np.errstate(all="ignore"):
        cone = fit_cone(rays, towards)
    if cone is not None:
        assert 0 < cone.sine < 1
        assert 0.03 < cone.distance_m(0.03) < math.inf
        assert cone.sine_share >= 0
