"""What the uncertainty of a lens does to distances, at each place in the picture."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import PARAMETERS, CameraModel, LensUncertainty
from stadimeter.errors import CalibrationError
from support.each_case import each_case

LENS = CameraModel(
    width_px=640,
    height_px=480,
    fx_px=612.0,
    fy_px=610.0,
    cx_px=315.0,
    cy_px=246.0,
    distortion=(-0.2, 0.06, 0.001, -0.0005, 0.01),
)
SIGMAS = (3.0, 3.0, 1.5, 1.5, 0.02, 0.1, 0.001, 0.001, 0.1)
NO_CORRELATION = (0.0,) * 36


def with_parameter(index: int, off: float) -> CameraModel:
    if index < 4:
        name = PARAMETERS[index] + "_px"
        return replace(LENS, **{name: getattr(LENS, name) + off})
    distortion = list(LENS.distortion)
    distortion[index - 4] += off
    return replace(LENS, distortion=tuple(distortion))


def solid_angle(model: CameraModel, place_px: np.ndarray) -> float:
    """Return how large a small round spot at a place is on the sphere of directions that the model gives it."""
    angles = np.linspace(0, 2 * np.pi, 181)[:-1]
    rim = model.directions(place_px + 0.5 * np.column_stack((np.cos(angles), np.sin(angles))))
    rays = np.column_stack((rim, np.ones(len(rim)))) / np.sqrt(1 + (rim**2).sum(axis=1))[:, None]
    axis = rays.mean(axis=0) / np.linalg.norm(rays.mean(axis=0))
    across = np.cross(axis, [0, 0, 1]) / np.linalg.norm(np.cross(axis, [0, 0, 1]))
    x, y = rays @ across / (rays @ axis), rays @ np.cross(axis, across) / (rays @ axis)
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


@each_case("index", range(9), ids=PARAMETERS)
def test_an_error_of_a_parameter_changes_distance_and_direction_as_predicted(index: int) -> None:
    off = 1e-3 if index < 4 else 1e-6
    more, less = (with_parameter(index, sign * off) for sign in (1, -1))
    for place in ((600.0, 50.0), (40.0, 430.0), (330.0, 200.0)):
        place_px = np.array(place)
        nearer = np.log(solid_angle(more, place_px) / solid_angle(less, place_px)) / (4 * off)
        turned = (more.directions(place_px[None]) - less.directions(place_px[None]))[0] / (2 * off)
        predicted = LENS.sensitivities(place_px[None])[0, :, index]
        assert predicted == pytest.approx([-nearer, *turned], rel=5e-3, abs=1e-7)


def test_without_it_the_focal_length_alone_counts_everywhere() -> None:
    plain = replace(LENS, focal_relative_sigma=0.004)
    assert plain.distance_share(3.0, 4.0) == plain.distance_share(320.0, 240.0) == 0.004


def test_the_share_is_that_of_the_covariance_and_never_less_than_the_focal_length_s() -> None:
    known = replace(LENS, uncertainty=LensUncertainty(sigmas=SIGMAS, correlations=NO_CORRELATION))
    for place in ((12.0, 20.0), (601.5, 33.0), (320.0, 240.0), (639.0, 479.0)):
        slopes = LENS.sensitivities(np.array([place]))[0, 0]
        assert known.distance_share(*place) == pytest.approx(float(np.linalg.norm(slopes * SIGMAS)), rel=0.02)
    assert replace(known, focal_relative_sigma=0.3).distance_share(12.0, 20.0) == 0.3


@given(x=st.floats(), y=st.floats())
def test_any_place_has_a_share(x: float, y: float) -> None:
    known = replace(LENS, uncertainty=LensUncertainty(sigmas=SIGMAS, correlations=NO_CORRELATION))
    assert 0 < known.distance_share(x, y) < 1


def test_it_is_the_same_at_another_resolution() -> None:
    known = replace(LENS, uncertainty=LensUncertainty(sigmas=SIGMAS, correlations=NO_CORRELATION))
    double = known.scaled_to(1280, 960)
    for x, y in ((10, 12), (500, 300)):
        assert double.distance_share(2 * x + 0.5, 2 * y + 0.5) == pytest.approx(known.distance_share(x, y), rel=0.01)


@given(seed=st.integers(0, 10_000), spread=st.floats(0, 6))
def test_a_covariance_survives_being_written_as_sigmas_and_correlations(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(9, 12)) * 10.0 ** rng.uniform(-spread, 1, 9)[:, None]
    covariance = root @ root.T
    scale = np.sqrt(np.diag(covariance))
    kept = LensUncertainty.of(covariance).covariance()
    assert kept / np.outer(scale, scale) == pytest.approx(covariance / np.outer(scale, scale), abs=1e-5)


@pytest.mark.parametrize(
    ("sigmas", "correlations", "complaint"),
    [
        (SIGMAS[:5], NO_CORRELATION, "lens_sigmas has to hold 9 numbers"),
        ((-1.0, *SIGMAS[1:]), NO_CORRELATION, "zero or more"),
        (SIGMAS, NO_CORRELATION[:35], "36 numbers"),
        (SIGMAS, (1.0, 1.0, *(0.0,) * 34), "contradict"),
        (SIGMAS, (float("nan"), *NO_CORRELATION[1:]), "36 numbers"),
    ],
)
def test_what_cannot_be_a_covariance_is_refused(
    sigmas: tuple[float, ...], correlations: tuple[float, ...], complaint: str
) -> None:
    with pytest.raises(CalibrationError, match=complaint):
        LensUncertainty(sigmas=sigmas, correlations=correlations)
