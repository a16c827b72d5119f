"""Two cameras: how they stand, and the targets that they triangulate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, TargetShape, Values
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.core.stereo_rig import UNKNOWNS, StereoRig, with_uncertainties
from stadimeter.errors import CalibrationError
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import DiscShape, SheetShape, TagShape
from stadimeter.ranging.measure import SeenTarget, measure
from stadimeter.ranging.stereo import measure_pair, triangulate
from stadimeter.ranging.stereo_calibration import PairView, StereoCalibration
from support.scenes.ball import BallTarget
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.scene import Scene
from support.scenes.target import Target
from support.stereo import (
    BOARD_M,
    calibrate_pairs,
    calibrated_rig,
    drawn_pairs,
    in_right,
    known_exactly,
    pair_of,
    project,
    true_rig,
)

# Two cameras triangulate targets exactly, say how sure that is, and join it with what the targets' sizes say.

POSE = Pose(position_m=(0.2, -0.1, 1.4), tilt_rad=0.5, tilt_towards_rad=1.0, roll_rad=0.2)
TARGETS = {
    "ball": (BallTarget(position_m=POSE.position_m, diameter_m=0.067), BallShape(diameter_m=0.067)),
    "sheet": (SheetTarget(pose=POSE, width_m=0.297, height_m=0.21), SheetShape(width_m=0.297, height_m=0.21)),
    "tag": (TagTarget(pose=POSE, side_m=0.1), TagShape(side_m=0.1)),
    "disc": (DiscTarget(pose=POSE, diameter_m=0.12), DiscShape(diameter_m=0.12)),
}
DISTANCE_M = math.hypot(*POSE.position_m)


@pytest.fixture(scope="module")
def rig() -> StereoRig:
    return known_exactly(true_rig(4))


def seen(target: Target, shape: TargetShape, lens: CameraModel, sigma_px: float = 0.05, turned: int = 0) -> SeenTarget:
    """What a perfect detector says; its corners may begin with another one."""
    outline_px = np.roll(project(target.outline_m(), lens), turned, axis=0)
    low, high = outline_px.min(axis=0), outline_px.max(axis=0)
    if shape.has_corners:
        sides = np.linalg.norm(outline_px - np.roll(outline_px, 1, axis=0), axis=1)
        width_px, height_px = float(sides[1::2].mean()), float(sides[::2].mean())
    else:
        width_px = height_px = _diameter_px(outline_px, is_ball=shape.limb_radius_m > 0)
    found = Detection(
        target="it",
        status=DetectionStatus.FOUND,
        outline_px=outline_px,
        centre_px=tuple(((low + high) / 2).tolist()),
        width_px=width_px,
        height_px=height_px,
        size_sigma_px=sigma_px,
    )
    return SeenTarget(detection=found, measurement=measure(found, shape, lens, 0.0), shape=shape)


def _diameter_px(outline_px: Points, *, is_ball: bool) -> float:
    across = np.linalg.norm(outline_px - np.roll(outline_px, len(outline_px) // 2, axis=0), axis=1)
    return float(across.min() if is_ball else across.max())


def both(name: str, rig: StereoRig, size: float = 1.0, turned: int = 0) -> tuple[SeenTarget, SeenTarget]:
    """What both cameras see of a target that is larger than stated by a factor."""
    target, shape = TARGETS[name]
    lengths = {key: value * size for key, value in _lengths(target).items()}
    scenes = pair_of(Scene(camera=rig.left, target=replace(target, **lengths), seed=1), rig)
    return seen(scenes.left.target, shape, rig.left), seen(scenes.right.target, shape, rig.right, turned=turned)


def _lengths(target: Target) -> dict[str, float]:
    return {
        key: getattr(target, key) for key in ("diameter_m", "width_m", "height_m", "side_m") if hasattr(target, key)
    }


def test_rays_to_points_meet_in_them(rig: StereoRig) -> None:
    points_m = np.random.default_rng(1).uniform((-0.5, -0.4, 0.5), (0.5, 0.4, 3.0), (20, 3))
    left, right = project(points_m, rig.left), project(in_right(points_m, rig), rig.right)
    pose = np.array((*rig.turn_rad, *rig.place_m))
    found, misses = triangulate(rig.left.directions(left), rig.right.directions(right), pose)
    assert found == pytest.approx(points_m, abs=1e-9)
    assert misses == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", TARGETS)
def test_every_kind_of_target_is_triangulated(rig: StereoRig, name: str) -> None:
    measured, figures = measure_pair(*both(name, rig), rig)
    assert figures.distance_m == pytest.approx(DISTANCE_M, rel=1e-5)
    assert figures.size_m == pytest.approx(DISTANCE_M, rel=2e-3)
    assert measured.distance_m == pytest.approx(DISTANCE_M, rel=1e-3)
    assert measured.position_m == pytest.approx(POSE.position_m, abs=3e-3)
    assert abs(figures.miss_px) < 0.2
    assert not figures.disagreement


@pytest.mark.parametrize("name", TARGETS)
def test_the_distance_of_both_together_does_not_need_the_size(rig: StereoRig, name: str) -> None:
    measured, figures = measure_pair(*both(name, rig, size=1.04), rig)
    assert figures.distance_m == pytest.approx(DISTANCE_M, rel=2e-3)
    assert figures.size_m == pytest.approx(DISTANCE_M / 1.04, rel=3e-3)
    assert "σ apart: it is 4." in figures.disagreement or "σ apart: it is 3.9 %" in figures.disagreement
    assert figures.disagreement.endswith("% larger than stated, or the cameras have moved against each other")
    # One of both is wrong, and the interval holds both.
    assert measured.distance_m == figures.distance_m
    assert measured.sigma_m > 0.9 * abs(figures.distance_m - figures.size_m)


@pytest.mark.parametrize("turned", [1, 2, 3])
def test_corners_of_a_sheet_are_matched_wherever_they_begin(rig: StereoRig, turned: int) -> None:
    figures = measure_pair(*both("sheet", rig, turned=turned), rig)[1]
    assert figures.distance_m == pytest.approx(DISTANCE_M, rel=1e-5)


def test_swapped_pictures_are_said(rig: StereoRig) -> None:
    left, right = both("tag", rig)
    measured, figures = measure_pair(right, left, rig)
    assert figures is None
    assert measured.status is MeasurementStatus.ERROR
    assert measured.distance_m is None
    assert "are the left and the right picture swapped?" in measured.reason


def test_cameras_that_have_moved_are_said_and_give_no_distance(rig: StereoRig) -> None:
    tilted = replace(rig, turn_rad=(rig.turn_rad[0] + 0.01, *rig.turn_rad[1:]))
    measured, figures = measure_pair(*both("ball", rig), tilted)
    assert figures is None
    assert measured.distance_m is None
    assert "miss each other by" in measured.reason
    assert "moved against each other; then calibrate again" in measured.reason


def test_noise_of_the_detections_is_carried_through(rig: StereoRig) -> None:
    target, shape = TARGETS["sheet"]
    scenes = pair_of(Scene(camera=rig.left, target=target, seed=1), rig)
    rng = np.random.default_rng(2)
    missed = []
    for _ in range(100):
        pair = []
        for scene, lens in ((scenes.left, rig.left), (scenes.right, rig.right)):
            one = seen(scene.target, shape, lens, sigma_px=0.2 * math.sqrt(2))
            off = replace(one.detection, outline_px=one.detection.outline_px + rng.normal(0, 0.2, (4, 2)))
            pair.append(SeenTarget(detection=off, measurement=measure(off, shape, lens, 0.0), shape=shape))
        figures = measure_pair(pair[0], pair[1], rig)[1]
        missed.append((figures.distance_m - DISTANCE_M) / figures.sigma_m)
    assert np.sqrt(np.mean(np.square(missed))) == pytest.approx(1.0, abs=0.15)


@pytest.mark.long
def test_errors_of_the_calibration_are_carried_through() -> None:
    missed: dict[str, list[float]] = {"together": [], "joined": []}
    for seed in range(40):
        true = true_rig(seed)
        known = calibrated_rig(true, seed)
        measured, figures = measure_pair(*both_through(true, known), known)
        missed["together"].append((figures.distance_m - DISTANCE_M) / figures.sigma_m)
        missed["joined"].append((measured.distance_m - DISTANCE_M) / measured.sigma_m)
    for values in missed.values():
        assert 0.7 < np.sqrt(np.mean(np.square(values))) < 1.3


def both_through(true: StereoRig, known: StereoRig) -> Sequence[SeenTarget]:
    """What cameras see, as it is measured with what is known of them."""
    target, shape = TARGETS["tag"]
    scenes = pair_of(Scene(camera=true.left, target=target, seed=1), true)
    made = []
    for scene, lens, believed in ((scenes.left, true.left, known.left), (scenes.right, true.right, known.right)):
        found = seen(scene.target, shape, lens).detection
        made.append(SeenTarget(detection=found, measurement=measure(found, shape, believed, 0.0), shape=shape))
    return made


def unsure(rig: StereoRig, sigmas: dict[int, float]) -> StereoRig:
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))
    for index, sigma in sigmas.items():
        covariance[index, index] = sigma**2
    return with_uncertainties(replace(rig, covariance=covariance))


def test_what_is_surer_counts_more_and_both_together_are_surer_than_each(rig: StereoRig) -> None:
    left, right = both("ball", rig)
    measured, figures = measure_pair(left, right, unsure(rig, {21: 0.002}))
    assert measured.sigma_m < min(figures.sigma_m, figures.size_sigma_m)
    vague, _ = measure_pair(left, right, unsure(rig, {21: 0.05}))
    assert vague.sigma_m == pytest.approx(figures.size_sigma_m, rel=0.01)


def test_the_error_of_a_size_does_not_average_out_between_both_cameras(rig: StereoRig) -> None:
    target, shape = TARGETS["ball"]
    loose = replace(shape, relative_sigma=0.05)
    scenes = pair_of(Scene(camera=rig.left, target=target, seed=1), rig)
    figures = measure_pair(
        seen(scenes.left.target, loose, rig.left), seen(scenes.right.target, loose, rig.right), unsure(rig, {21: 0.01})
    )[1]
    assert figures.size_sigma_m >= 0.049 * figures.size_m


def test_discs_near_by_are_no_more_off_than_far_ones(rig: StereoRig) -> None:
    # Half way between both poses, as one camera puts it, a disc this near and tilted would be 1 % off.
    near = replace(TARGETS["disc"][0], pose=replace(POSE, position_m=(0.05, 0.02, 0.4), tilt_rad=0.9))
    scenes = pair_of(Scene(camera=rig.left, target=near, seed=1), rig)
    shape = TARGETS["disc"][1]
    figures = measure_pair(seen(scenes.left.target, shape, rig.left), seen(scenes.right.target, shape, rig.right), rig)[
        1
    ]
    assert figures.distance_m == pytest.approx(math.hypot(0.05, 0.02, 0.4), rel=1e-5)


# Boards before two cameras tell where the right one is, how sure that is, and which pairs do not belong together.


@pytest.fixture(scope="module")
def true() -> StereoRig:
    return true_rig(3)


@pytest.fixture(scope="module")
def made(true: StereoRig) -> StereoCalibration:
    return calibrate_pairs(drawn_pairs(true, 3))


def pose_of(rig: StereoRig) -> Values:
    return np.array((*rig.turn_rad, *rig.place_m))


def moved(pair: PairView, off_px: tuple[float, float]) -> PairView:
    """Return a pair whose board moved before the right picture was taken."""
    return replace(pair, right=replace(pair.right, corners_px=pair.right.corners_px + off_px))


def test_the_pose_and_both_lenses_are_found_again(true: StereoRig, made: StereoCalibration) -> None:
    assert made.rig.place_m == pytest.approx(true.place_m, abs=0.0005)
    assert made.rig.turn_rad == pytest.approx(true.turn_rad, abs=0.004)
    assert made.rig.left.fx_px == pytest.approx(true.left.fx_px, rel=0.003)
    assert made.rig.right.fx_px == pytest.approx(true.right.fx_px, rel=0.003)
    assert made.rms_px == pytest.approx(0.1 * math.sqrt(2), rel=0.1)
    assert made.epipolar_px == pytest.approx(0.1 * math.sqrt(2), rel=0.15)
    assert not any(each.why_left_out for each in made.pairs)
    assert all(0.2 < each.distance_m < 1.1 for each in made.pairs)


@pytest.mark.long
def test_the_stated_uncertainty_of_turn_and_place_holds() -> None:
    missed = []
    for seed in range(24):
        true = true_rig(seed)
        rig = calibrate_pairs(drawn_pairs(true, seed)).rig
        missed.append((pose_of(rig) - pose_of(true)) / np.sqrt(np.diag(rig.covariance)[-6:]))
    assert 0.6 < np.sqrt(np.mean(np.square(missed))) < 1.3


def test_pairs_of_different_times_are_named_and_left_out(true: StereoRig, made: StereoCalibration) -> None:
    pairs = drawn_pairs(true, 3)
    pairs[3], pairs[8] = moved(pairs[3], (6.0, 2.0)), moved(pairs[8], (0.0, 5.0))
    found = calibrate_pairs(pairs)
    assert [number for number, each in enumerate(found.pairs) if each.why_left_out] == [3, 8]
    assert "px, the others allow" in found.pairs[3].why_left_out
    assert "were both taken at the same time?" in found.pairs[3].why_left_out
    assert found.pairs[3].rms_px > 1.0
    assert found.rig.place_m == pytest.approx(true.place_m, abs=0.0005)
    assert found.rms_px == pytest.approx(made.rms_px, rel=0.1)


def test_one_camera_twice_is_no_pair_of_cameras(true: StereoRig) -> None:
    pairs = [replace(each, right=each.left) for each in drawn_pairs(true, 3)]
    with pytest.raises(CalibrationError, match="are these pictures of two cameras"):
        calibrate_pairs(pairs)


def test_a_view_that_one_camera_could_not_use_leaves_out_its_pair(true: StereoRig, made: StereoCalibration) -> None:
    pairs = drawn_pairs(true, 3)
    shaken = pairs[4].right.corners_px + np.random.default_rng(9).normal(0, 2.0, (54, 2))
    pairs[4] = replace(pairs[4], right=replace(pairs[4].right, corners_px=shaken))
    found = calibrate_pairs(pairs)
    assert [each.right for each in found.pairs if each.why_left_out] == ["right04.png"]
    assert found.rms_px == pytest.approx(made.rms_px, rel=0.1)


def test_boards_that_are_partly_hidden_differently_in_both_pictures_will_do(true: StereoRig) -> None:
    pairs = []
    for pair in drawn_pairs(true, 3):
        left = replace(pair.left, board_m=pair.left.board_m[:45], corners_px=pair.left.corners_px[:45])
        right = replace(pair.right, board_m=pair.right.board_m[9:], corners_px=pair.right.corners_px[9:])
        pairs.append(PairView(left=left, right=right))
    found = calibrate_pairs(pairs)
    assert found.rig.place_m == pytest.approx(true.place_m, abs=0.001)
    assert found.epipolar_px < 0.2


def test_a_bent_board_is_allowed_for(true: StereoRig) -> None:
    bent_m = np.column_stack((BOARD_M, 0.001 * (BOARD_M[:, 0] / 0.1 - 1) ** 2))
    found = calibrate_pairs(drawn_pairs(true, 3, board_m=bent_m))
    assert found.rms_px == pytest.approx(0.1 * math.sqrt(2), rel=0.1)
    assert found.rig.place_m == pytest.approx(true.place_m, abs=0.0007)


def test_opencvs_thirteen_pairs_reach_the_figure(real_pictures: Path) -> None:
    from stadimeter.workbench.calibration.board_session import Chessboard
    from stadimeter.workbench.stereo import find_board_pairs, pair_pictures

    pairs = pair_pictures(sorted((real_pictures / "chessboard").glob("*[0-9].jpg")))
    found = find_board_pairs(pairs, Chessboard(columns=9, rows=6, square_m=0.025)).calibrate(0.002)
    assert len(found.pairs) == 13
    assert not any(each.why_left_out for each in found.pairs)
    assert found.rms_px <= 0.30
    assert found.epipolar_px <= 0.2
    # OpenCV's own program finds 3.34 squares of 25 mm between both cameras.
    assert found.rig.baseline_m == pytest.approx(0.0833, rel=0.01)
