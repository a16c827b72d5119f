"""The distance of a sheet from its corners and from one side, drawn and real."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.ranging.calibration import KnownDistance, calibrate
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.measure import measure
from stadimeter.ranging.plane_pose import rectangle
from support.corners import detection_of_corners
from support.scenes.draw import CAMERA, sheet_scene
from support.scenes.plane import Pose
from support.scenes.render import render
from support.through_lens import ThroughLens

pytestmark = pytest.mark.vision


# The distance of a sheet from its corners, and from one side.

SIZE = SheetShape(width_m=0.297, height_m=0.210)
CORNERS_M = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (SIZE.width_m / 2, SIZE.height_m / 2)


def seen_from(pose: Pose, sigma_px: float = 0.05, first: int = 0) -> Detection:
    placed = pose.placed(CORNERS_M)
    corners = np.roll(CAMERA.project(placed[:, :2] / placed[:, 2:]), first, axis=0)
    return detection_of_corners(corners, sigma_px, "paper")


@given(
    x=st.floats(-0.4, 0.4),
    z=st.floats(0.4, 4.0),
    tilt=st.floats(0, 1.1),
    towards=st.floats(0, 2 * math.pi),
    roll=st.floats(-math.pi, math.pi),
    first=st.integers(0, 3),
)
def test_exact_corners_give_the_exact_place_however_the_sheet_hangs(x, z, tilt, towards, roll, first) -> None:
    place = (x * z, 0.2 * z, z)
    pose = Pose(position_m=place, tilt_rad=tilt, tilt_towards_rad=towards, roll_rad=roll)
    reading = SIZE.locate(seen_from(pose, first=first), CAMERA)
    assert math.dist(reading.position_m, place) < 1e-4 * math.hypot(*place)
    assert 0 < reading.noise_share < 0.05
    assert reading.ambiguity < 1


def worst_share_off(depths_m: list[float], tilts_rad: list[float], directions: int, rolls_rad: list[float]) -> float:
    """Return how far off the place of a sheet with exact corners is at worst, as a share, over a grid of poses."""
    worst = 0.0
    sideways, towards = (-0.4, -0.25, 0.0, 0.25, 0.4), [2 * math.pi * each / directions for each in range(directions)]
    grid = itertools.product(sideways, depths_m, tilts_rad, towards, rolls_rad, (0, 1))
    for x, z, tilt_rad, towards_rad, roll_rad, first in grid:
        place = (x * z, 0.2 * z, z)
        pose = Pose(position_m=place, tilt_rad=tilt_rad, tilt_towards_rad=towards_rad, roll_rad=roll_rad)
        found = SIZE.locate(seen_from(pose, first=first), CAMERA).position_m
        worst = max(worst, math.dist(found, place) / math.hypot(*place))
    return worst


def test_a_far_sheet_that_hangs_straight_and_is_turned_far_away_is_not_taken_the_wrong_way_round() -> None:
    assert worst_share_off([4.0], [0.83, 0.97, 1.1], 12, [0.0]) < 1e-4


@pytest.mark.long
def test_exact_corners_give_the_exact_place_on_a_grid_of_6240_poses() -> None:
    tilts_rad = [0.05 + 0.15 * each for each in range(8)]
    assert worst_share_off([0.4, 1.0, 2.0, 3.0, 4.0], tilts_rad, 12, [0.0]) < 1e-4
    assert worst_share_off([2.0, 4.0], [0.5, 0.8, 1.1], 12, [0.6, math.pi / 2]) < 1e-4


@pytest.mark.parametrize("known_side", ["width", "height"])
def test_the_turn_of_a_sheet_with_a_named_side_is_corrected_and_leaves_a_doubt(known_side: str) -> None:
    size = SheetShape(width_m=SIZE.width_m, height_m=SIZE.height_m, known_side=known_side)
    facing, *turned = (
        size.locate(seen_from(Pose(position_m=(0, 0, 1), tilt_rad=tilt, tilt_towards_rad=towards)), CAMERA)
        for tilt, towards in ((0, 0), (0.5, 0), (0.5, math.pi / 2))
    )
    assert [each.position_m[2] for each in (facing, *turned)] == pytest.approx([1.0] * 3, rel=2e-3)
    assert max(each.systematic_share for each in turned) > facing.systematic_share + 0.03


@settings(max_examples=20)
@given(depth_m=st.floats(0.5, 3.0), tilt=st.floats(0, 0.6), towards=st.floats(0, 2 * math.pi))
def test_the_focal_length_of_a_tilted_sheet_at_a_known_depth_is_right(depth_m, tilt, towards) -> None:
    seen = seen_from(Pose(position_m=(0, 0, depth_m), tilt_rad=tilt, tilt_towards_rad=towards))
    known = KnownDistance(picture="a.png", width_px=640, height_px=480, detection=seen, size=SIZE, depth_m=depth_m)
    model = calibrate([known], date="").camera_model
    assert measure(seen, SIZE, model, 0.0).depth_m == pytest.approx(depth_m, rel=1e-6)
    assert model.fx_px == pytest.approx(CAMERA.fx_px, rel=0.02)


def test_rendered_sheets_are_measured_to_a_thousandth_and_the_interval_holds_the_truth() -> None:
    options = SheetOptions.model_validate({"width": "29.7 cm", "height": "21 cm"})
    detector = ThroughLens(SheetDetector("paper", options), CAMERA)
    inside = []
    for seed in range(30, 42):
        made = render(sheet_scene(seed, 0.25 * (seed % 5), plain=True))
        frame = Frame(made.image, 0.0, 0)
        measured = detector.measure(frame)
        error_m = measured.distance_m - made.truth.distance_m
        assert abs(error_m) < 0.002 * made.truth.distance_m, seed
        inside.append(abs(error_m) < 1.96 * measured.sigma_m)
    assert sum(inside) >= 10


# Which way a sheet hangs, where its corners hardly tell.

PLAIN_CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
CARD = SheetShape(width_m=0.1, height_m=0.075)


def seen_roughly(
    rng: np.random.Generator, tilt_rad: float, corner_sigma_px: float, depth_m: float
) -> tuple[Detection, float]:
    """Return a card whose corners are off by noise, and how far away it truly is: at 3 m it appears 20 px wide."""
    towards = float(rng.uniform(0, 2 * math.pi))
    turn = cv2.Rodrigues(np.array((math.cos(towards), math.sin(towards), 0.0)) * tilt_rad)[0] @ np.diag((1, -1, -1))
    placed = rectangle(CARD.width_m, CARD.height_m) @ turn.T + (0.1, 0.05, depth_m)
    corners = PLAIN_CAMERA.project(placed[:, :2] / placed[:, 2:]) + rng.normal(0, corner_sigma_px, (4, 2))
    return detection_of_corners(corners, math.sqrt(2) * corner_sigma_px), math.hypot(0.1, 0.05, depth_m)


def test_a_small_card_is_not_taken_to_hang_the_other_way_and_to_be_turned_far_away() -> None:
    """Either way explains its corners; the wrong one is 15 to 25 % nearer."""
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(200):
        found, true_m = seen_roughly(rng, math.radians(rng.uniform(0, 30)), 0.25, rng.uniform(2.0, 3.5))
        x, y, z = CARD.locate(found, PLAIN_CAMERA).position_m
        errors.append(math.hypot(x, y, z) / true_m - 1)
    assert np.mean(np.abs(errors) > 0.1) < 0.06


def test_a_sheet_that_is_turned_far_away_is_measured_so_where_its_corners_tell() -> None:
    rng = np.random.default_rng(6)
    for _ in range(50):
        found, true_m = seen_roughly(rng, math.radians(60), 0.01, rng.uniform(0.3, 0.6))
        x, y, z = CARD.locate(found, PLAIN_CAMERA).position_m
        assert abs(math.hypot(x, y, z) / true_m - 1) < 0.01


# The tutorial that this program grew from, on its own pictures; and what we make of them.

INCH_M = 0.0254
NAMES = ("2ft", "3ft", "4ft")


def _frame(path: Path) -> Frame:
    return Frame(cv2.imread(str(path)), 0.0, 0)


def test_calibrated_at_two_feet_the_sheet_at_three_and_four_is_right_within_three_per_cent(real_pictures: Path) -> None:
    options = SheetOptions.model_validate({"width": "11 in", "height": "8.5 in"})
    detector = SheetDetector("paper", options)
    folder = real_pictures / "seed_sheet"
    first = _frame(folder / "2ft.png")
    known = KnownDistance(
        picture="2ft.png",
        width_px=first.width_px,
        height_px=first.height_px,
        detection=detector.detect(first),
        size=detector.target_shape,
        depth_m=24 * INCH_M,
    )
    camera = calibrate([known], date="").camera_model
    # The EXIF data say 673 to 693 px; the tape is good to an inch of 24, which is 4.2 per cent.
    assert camera.fx_px == pytest.approx(673, rel=0.045)
    pictures = [folder / f"{name}.png" for name in NAMES[1:]]
    originals = [folder / "original" / f"{name}.jpg" for name in NAMES[1:]]
    # The same for every version of OpenCV, to 0.1 %.
    expected_in = dict(zip((*pictures, *originals), (36.20, 46.98, 36.17, 46.90), strict=True))
    for path in (*pictures, *originals):
        frame = _frame(path)
        measured = ThroughLens(detector, camera).measure(frame)
        inches = measured.distance_m / INCH_M
        assert inches == pytest.approx(12 * int(path.stem[0]), rel=0.03), path
        assert abs(inches - 12 * int(path.stem[0])) < 1 + 1.96 * measured.sigma_m / INCH_M, path
        assert inches == pytest.approx(expected_in[path], rel=0.001), path
