"""Boards before two cameras tell where the right one is, how sure that is, and which pairs do not belong together."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.detection import Values
from stadimeter.core.stereo_rig import StereoRig
from stadimeter.errors import CalibrationError
from stadimeter.ranging.stereo_calibration import PairView, StereoCalibration
from support.stereo import BOARD_M, calibrate_pairs, drawn_pairs, true_rig


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


def test_corners_without_noise_give_the_pose_to_many_digits(true: StereoRig) -> None:
    rig = calibrate_pairs(drawn_pairs(true, 5, noise_px=1e-4)).rig
    assert pose_of(rig) == pytest.approx(pose_of(true), abs=1e-5)


@pytest.mark.long
def test_the_stated_uncertainty_of_turn_and_place_holds() -> None:
    missed = []
    for seed in range(24):
        true = true_rig(seed)
        rig = calibrate_pairs(drawn_pairs(true, seed)).rig
        missed.append((pose_of(rig) - pose_of(true)) / np.sqrt(np.diag(rig.covariance)[-6:]))
    assert 0.6 < np.sqrt(np.mean(np.square(missed))) < 1.3


def test_a_square_that_is_not_known_makes_the_baseline_as_unsure(true: StereoRig) -> None:
    known, unsure = (calibrate_pairs(drawn_pairs(true, 3), share).rig for share in (0.0, 0.01))
    of_square_m = math.sqrt(unsure.baseline_sigma_m**2 - known.baseline_sigma_m**2)
    assert of_square_m == pytest.approx(0.01 * unsure.baseline_m, rel=1e-3)


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


def test_pairs_in_another_order_do_not_belong_together(true: StereoRig) -> None:
    pairs = drawn_pairs(true, 3)
    turned = [replace(one, right=other.right) for one, other in zip(pairs, pairs[1:] + pairs[:1], strict=True)]
    with pytest.raises(CalibrationError, match=r"do not belong together: .* given in the same order"):
        calibrate_pairs(turned)


def test_swapped_cameras_are_said(true: StereoRig) -> None:
    swapped = [PairView(left=each.right, right=each.left) for each in drawn_pairs(true, 3)]
    with pytest.raises(CalibrationError, match=r"left and right are swapped: .* 0\.1\d\d m to the left"):
        calibrate_pairs(swapped)


def test_one_camera_twice_is_no_pair_of_cameras(true: StereoRig) -> None:
    pairs = [replace(each, right=each.left) for each in drawn_pairs(true, 3)]
    with pytest.raises(CalibrationError, match="are these pictures of two cameras"):
        calibrate_pairs(pairs)


def test_two_pairs_are_too_few(true: StereoRig) -> None:
    with pytest.raises(CalibrationError, match="in 2 different views"):
        calibrate_pairs(drawn_pairs(true, 3, count=2))


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
