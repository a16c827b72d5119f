"""The distance of a disc from its outline, exact or measured in rendered pictures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.disc import DiscDetector, DiscOptions
from stadimeter.detectors.disc.ellipse import ellipse_through
from stadimeter.ranging.flat import DiscShape
from stadimeter.ranging.measure import measure
from stadimeter.ranging.similar_triangles import expect, farthest_m
from support.scenes.draw import CAMERA, disc_scene
from support.scenes.nuisances import SHEET_NUISANCES
from support.scenes.plane import Pose
from support.scenes.render import render
from support.through_lens import ThroughLens

pytestmark = pytest.mark.vision

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


@pytest.mark.parametrize("tilt_deg", [0, 20, 50])
def test_the_tilt_is_told_and_that_its_side_is_not_known(tilt_deg: int) -> None:
    pose = Pose(position_m=(0.0, 0.0, 1.0), tilt_rad=math.radians(tilt_deg))
    reading = SIZE.locate(seen_from(pose), CAMERA)
    assert math.degrees(reading.tilt_rad) == pytest.approx(tilt_deg, abs=0.1)
    assert reading.ambiguity == 1.0
    assert reading.systematic_share == 0.0, "both poses are equally far away"


def test_the_uncertainty_is_that_of_the_larger_diameter_and_of_the_size() -> None:
    pose = Pose(position_m=(0.0, 0.0, 1.0), tilt_rad=0.7)
    detection = seen_from(pose, sigma_px=0.1)
    assert SIZE.locate(detection, CAMERA).noise_share == pytest.approx(0.1 / detection.width_px, rel=1e-6)
    unsure = measure(detection, replace(SIZE, relative_sigma=0.02), CAMERA, 0.0)
    assert unsure.sigma_m == pytest.approx(unsure.distance_m * math.hypot(0.02, 0.1 / detection.width_px), rel=1e-6)


@pytest.mark.parametrize("outline", [np.empty((0, 2)), np.full((20, 2), 100.0)])
def test_without_an_outline_the_larger_diameter_gives_the_distance(outline) -> None:
    detection = replace(seen_from(Pose(position_m=(0.1, 0.0, 1.0))), outline_px=outline)
    reading = SIZE.locate(detection, CAMERA)
    assert reading.position_m == pytest.approx((0.1, 0.0, 1.0), rel=1e-3)
    assert reading.tilt_rad is None


def test_the_larger_diameter_is_compared_with_the_disc_however_it_is_turned() -> None:
    for tilt_rad in (0.0, 1.0):
        seen = replace(seen_from(Pose(position_m=(0, 0, 1), tilt_rad=tilt_rad)), outline_px=np.empty((0, 2)))
        assert SIZE.locate(seen, CAMERA).position_m[2] == pytest.approx(1.0, rel=0.02)


def test_what_to_expect_of_a_disc_follows_from_its_diameter() -> None:
    assert expect(SIZE, CAMERA, 2.0).size_px == pytest.approx(36.0)
    assert expect(SIZE, CAMERA, farthest_m(SIZE, CAMERA)).size_px == pytest.approx(12.0)


@pytest.mark.parametrize("tilt_deg", [0, 25, 50])
def test_the_error_is_less_than_a_thousandth(tilt_deg: int) -> None:
    errors = [abs(error) for error, _ in _errors(range(900, 906), tilt_deg, "clean")]
    assert len(errors) >= 5
    assert np.median(errors) < 0.0005
    assert max(errors) < 0.002


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
