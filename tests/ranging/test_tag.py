"""The distance of a tag from exact corners, from rendered scenes and from real pictures."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.detectors.tag import TagDetector, TagOptions
from stadimeter.ranging.flat import TagShape, ambiguity, upright_poses
from stadimeter.ranging.measure import measure
from support.corners import detection_of_corners
from support.scenes.draw import CAMERA, tag_scene
from support.scenes.nuisances import TAG_NUISANCES
from support.scenes.plane import Pose
from support.scenes.render import render
from support.through_lens import ThroughLens

pytestmark = pytest.mark.vision

SIZE = TagShape(side_m=0.1)
CORNERS_M = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * SIZE.side_m / 2
VISP_CAMERA = CameraModel(width_px=640, height_px=480, fx_px=615.17, fy_px=615.17, cx_px=312.19, cy_px=243.44)
DUCKIETOWN_CAMERA = CameraModel(
    width_px=1056, height_px=792, fx_px=329.8729619143081, fy_px=332.94611303946357, cx_px=528.0, cy_px=396.0
)


def seen_from(pose: Pose, camera: CameraModel = CAMERA, sigma_px: float = 0.05) -> Detection:
    placed = pose.placed(CORNERS_M)
    corners = camera.project(placed[:, :2] / placed[:, 2:])
    return detection_of_corners(corners, sigma_px, "tag")


@given(
    x=st.floats(-0.4, 0.4),
    y=st.floats(-0.3, 0.3),
    z=st.floats(0.3, 5.0),
    tilt=st.floats(0.01, 1.2),  # exactly from the front OpenCV loses a pose; the next test is about that
    towards=st.floats(0, 2 * math.pi),
    roll=st.floats(-math.pi, math.pi),
)
@example(x=0.25, y=0.25, z=2.0, tilt=0.0, towards=0.0, roll=0.0)
def test_exact_corners_give_the_exact_place(x, y, z, tilt, towards, roll) -> None:
    place = (x * z, y * z, z)
    pose = Pose(position_m=place, tilt_rad=tilt, tilt_towards_rad=towards, roll_rad=roll)
    reading = SIZE.locate(seen_from(pose), CAMERA)
    assert math.dist(reading.position_m, place) < 1e-4 * math.hypot(*place)


def test_distortion_is_undone() -> None:
    camera = replace(CAMERA, distortion=(-0.3, 0.09, 0.001, -0.0005, 0.0))
    pose = Pose(position_m=(0.2, -0.1, 0.6), tilt_rad=0.5)
    measured = measure(seen_from(pose, camera), SIZE, camera, 0.0)
    assert measured.distance_m == pytest.approx(math.hypot(0.2, -0.1, 0.6), rel=1e-6)
    assert measured.depth_m == pytest.approx(0.6, rel=1e-6)
    assert measured.bearing_rad == pytest.approx(math.atan2(0.2, 0.6), rel=1e-6)


def test_the_two_poses_are_told_apart_near_by_and_hardly_far_away() -> None:
    near, far = (
        upright_poses(CAMERA.directions(_shaken(seen_from(Pose(position_m=(0, 0, z), tilt_rad=0.4)))), 0.1, 0.1)
        for z in (0.3, 4)
    )
    assert len(near) == len(far) == 2
    assert near[0].misfit <= near[1].misfit
    assert ambiguity(near) < 0.1
    assert ambiguity(far) > 0.5
    assert ambiguity(near[:1]) == 0


def test_where_the_pose_is_ambiguous_the_systematic_share_says_how_much_it_matters() -> None:
    clear, doubtful = (
        SIZE.locate(seen_from(Pose(position_m=(0, 0, z), tilt_rad=0.6), sigma_px=0.1), CAMERA) for z in (0.3, 3)
    )
    assert clear.systematic_share < 1e-6
    assert 0 < doubtful.systematic_share < 0.02


def _shaken(detection: Detection) -> np.ndarray:
    return detection.outline_px + np.random.default_rng(3).normal(0, 0.05, (4, 2))


@pytest.mark.parametrize(("side_px", "limit"), [(48, 0.003), (100, 0.0015)])
def test_the_median_error_is_a_fraction_of_the_side_in_pixels(side_px: int, limit: float) -> None:
    errors = [abs(error) for error, _ in _errors(range(900, 905), side_px, "clean")]
    assert np.median(errors) < limit


@pytest.mark.long
def test_the_95_per_cent_interval_holds_the_truth() -> None:
    inside = [
        abs(error) < 1.96 * sigma
        for side_px in (36, 60, 100)
        for trouble in TAG_NUISANCES
        for error, sigma in _errors(range(2000, 2012), side_px, trouble)
    ]
    assert len(inside) > 120
    assert np.mean(inside) > 0.9


def _errors(seeds: range, side_px: float, trouble: str) -> list[tuple[float, float]]:
    """Return the relative errors and relative standard deviations of those tags that were found."""
    detector = ThroughLens(TagDetector("tag", TagOptions.model_validate({"side": "10 cm"})), CAMERA)
    found = []
    for seed in seeds:
        made = render(TAG_NUISANCES[trouble](tag_scene(seed, side_px, math.radians(15 * (seed % 4)))))
        frame = Frame(made.image, 0.0, 0)
        measured = detector.measure(frame)
        if measured.distance_m is not None:
            truth = made.truth.distance_m
            found.append((measured.distance_m / truth - 1, measured.sigma_m / truth))
    assert len(found) >= 0.75 * len(seeds)
    return found


def _reference_positions(folder: Path) -> dict[int, np.ndarray]:
    lines = [line for line in (folder / "ground_truth_pose.txt").read_text().splitlines() if line.strip()]
    return {
        int(name.rsplit("_", 1)[1]): np.array(pose.split(), float)[:3]
        for name, pose in zip(lines[::2], lines[1::2], strict=True)
    }


def test_twelve_real_tags_are_as_far_away_as_another_program_says(real_pictures: Path) -> None:
    frame = Frame(cv2.imread(str(real_pictures / "tags" / "visp" / "AprilTag.png")), 0.0, 0)
    truth = _reference_positions(real_pictures / "tags" / "visp")
    assert len(truth) == 12
    errors = []
    for number, position in truth.items():
        detector = ThroughLens(
            TagDetector("tag", TagOptions.model_validate({"side": "53 mm", "id": number})), VISP_CAMERA
        )
        measured = detector.measure(frame)
        assert measured.position_m == pytest.approx(position, abs=0.005), number
        errors.append(abs(measured.distance_m / float(np.linalg.norm(position)) - 1))
    assert np.median(errors) < 0.005


def test_a_real_tag_that_turns_stays_as_far_away(real_pictures: Path) -> None:
    detector = ThroughLens(TagDetector("tag", TagOptions.model_validate({"side": "65 mm"})), DUCKIETOWN_CAMERA)
    distances = []
    pictures = sorted((real_pictures / "tags" / "duckietown").glob("*.png"))
    assert len(pictures) == 7
    for path in pictures:
        frame = Frame(cv2.imread(str(path)), 0.0, 0)
        measured = detector.measure(frame)
        assert measured.distance_m is not None, path.name
        distances.append(measured.distance_m)
    assert max(abs(np.array(distances) / np.mean(distances) - 1)) < 0.02
