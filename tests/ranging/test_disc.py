"""Discs, circles and balls: poses and distances from their outlines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points
from stadimeter.core.frame import Frame
from stadimeter.detectors.disc import DiscDetector, DiscOptions
from stadimeter.detectors.disc.edges import ellipse_through
from stadimeter.ranging.ball import ConeFrame, fit_cone, with_ones
from stadimeter.ranging.flat import DiscShape, circle_poses, cone_through
from stadimeter.ranging.measure import measure
from support.scenes.draw import CAMERA, disc_scene
from support.scenes.nuisances import SHEET_NUISANCES
from support.scenes.plane import Pose
from support.scenes.render import render
from support.through_lens import ThroughLens

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]


# The distance of a disc from its outline, exact or measured in rendered pictures.

SIZE = DiscShape(diameter_m=0.12)
ANGLES = np.linspace(0, 2 * math.pi, 64, endpoint=False)
RIM_M = SIZE.diameter_m / 2 * np.column_stack((np.cos(ANGLES), np.sin(ANGLES)))


def seen_from(pose: Pose, camera: CameraModel = CAMERA, sigma_px: float = 0.05) -> Detection:
    placed = pose.placed(RIM_M)
    rim = camera.project(placed[:, :2] / placed[:, 2:])
    ellipse = ellipse_through(rim)
    larger, smaller, _ = ellipse.axes()
    return Detection(
        target="disc",
        status=DetectionStatus.FOUND,
        outline_px=rim,
        centre_px=(float(ellipse.centre_px[0]), float(ellipse.centre_px[1])),
        width_px=2 * larger,
        height_px=2 * smaller,
        size_sigma_px=sigma_px,
    )


@given(
    x=st.floats(-0.25, 0.25),
    y=st.floats(-0.2, 0.2),
    z=st.floats(0.3, 10.0),
    tilt=st.floats(0, 1.0),  # in a corner of the picture that is 73 degrees from the line of sight
    towards=st.floats(0, 2 * math.pi),
)
def test_an_exact_outline_gives_the_exact_distance_at_any_tilt(x, y, z, tilt, towards) -> None:
    pose = Pose(position_m=(x * z, y * z, z), tilt_rad=tilt, tilt_towards_rad=towards)
    measured = measure(seen_from(pose), SIZE, CAMERA, 0.0)
    assert measured.distance_m == pytest.approx(math.hypot(*pose.position_m), rel=1e-6)
    # The two poses lie on both sides of the line of sight that is told.
    assert math.dist(measured.position_m, pose.position_m) < SIZE.diameter_m / 2


def test_a_camera_with_oblong_pixels_and_a_bent_lens_is_allowed_for() -> None:
    camera = replace(CAMERA, fx_px=640.0, distortion=(-0.3, 0.09, 0.001, -0.0005, 0.0))
    pose = Pose(position_m=(0.2, -0.1, 0.7), tilt_rad=0.6, tilt_towards_rad=1.0)
    assert measure(seen_from(pose, camera), SIZE, camera, 0.0).distance_m == pytest.approx(
        math.hypot(0.2, -0.1, 0.7), rel=1e-6
    )


def test_the_uncertainty_is_that_of_the_larger_diameter_and_of_the_size() -> None:
    pose = Pose(position_m=(0.0, 0.0, 1.0), tilt_rad=0.7)
    detection = seen_from(pose, sigma_px=0.1)
    assert SIZE.locate(detection, CAMERA).noise_share == pytest.approx(0.1 / detection.width_px, rel=1e-6)
    unsure = measure(detection, replace(SIZE, relative_sigma=0.02), CAMERA, 0.0)
    assert unsure.sigma_m == pytest.approx(unsure.distance_m * math.hypot(0.02, 0.1 / detection.width_px), rel=1e-6)


@pytest.mark.long
def test_the_95_per_cent_interval_holds_the_truth() -> None:
    inside = [
        abs(error) < 1.96 * sigma
        for tilt_deg in (0, 20, 40, 55)
        for trouble in SHEET_NUISANCES
        for error, sigma in _errors(range(2000, 2012), tilt_deg, trouble)
    ]
    assert len(inside) > 200
    assert np.mean(inside) > 0.9


def _errors(seeds: range, tilt_deg: float, trouble: str) -> list[tuple[float, float]]:
    """Return the relative errors and relative standard deviations of those discs that were found."""
    detector = ThroughLens(DiscDetector("disc", DiscOptions.model_validate({"diameter": "12 cm"})), CAMERA)
    found = []
    for seed in seeds:
        made = render(SHEET_NUISANCES[trouble](disc_scene(seed, math.radians(tilt_deg), plain=True)))
        frame = Frame(made.image, 0.0, 0)
        measured = detector.measure(frame)
        if measured.distance_m is not None:
            truth = made.truth.distance_m
            found.append((measured.distance_m / truth - 1, measured.sigma_m / truth))
    return found


# The two poses of a circle that is seen as an ellipse.

DIAMETER_M = 0.12
COARSE_ANGLES = np.linspace(0, 2 * math.pi, 48, endpoint=False)
CIRCLE_M = DIAMETER_M / 2 * np.column_stack((np.cos(COARSE_ANGLES), np.sin(COARSE_ANGLES)))

PLACES = {
    "x": st.floats(-0.6, 0.6),
    "y": st.floats(-0.5, 0.5),
    "z": st.floats(0.2, 20.0),
    "tilt": st.floats(0, 1.2),
    "towards": st.floats(0, 2 * math.pi),
}


def rim(pose: Pose) -> np.ndarray:
    placed = pose.placed(CIRCLE_M)
    return placed[:, :2] / placed[:, 2:]


def seen_at(x, y, z, tilt, towards):
    pose = Pose(position_m=(x * z, y * z, z), tilt_rad=tilt, tilt_towards_rad=towards)
    return pose, circle_poses(cone_through(rim(pose)), DIAMETER_M)


@given(**PLACES)
def test_one_of_the_poses_is_the_true_one(x, y, z, tilt, towards) -> None:
    pose, found = seen_at(x, y, z, tilt, towards)
    # Near face on the tilt goes with the root of a difference of eigenvalues, and so do its rounding errors.
    off_m = min(math.dist(each.position_m, pose.position_m) for each in found.poses)
    assert off_m < 2e-4 * DIAMETER_M + 1e-6 * z
    toward_camera = -pose.rotation()[:, 2]
    facing = toward_camera if toward_camera @ pose.position_m < 0 else -toward_camera
    assert max(float(each.normal @ facing) for each in found.poses) > 1 - 1e-4


# The cone around a sphere, from rays that touch it.

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
