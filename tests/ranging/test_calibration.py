"""From pictures at known distances to a camera model, and how wrong that is by new ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, TargetShape
from stadimeter.errors import CalibrationError
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.calibration import (
    BIAS_STEP_PX,
    CalibrationCheck,
    KnownDistance,
    calibrate,
    check_agreement,
    check_calibration,
)
from stadimeter.ranging.flat import SheetShape

# From pictures at known distances to a camera model.

INCH_M = 0.0254
LETTER = SheetShape(width_m=11 * INCH_M, height_m=8.5 * INCH_M)
MIDDLE = (319.5, 239.5)
Seen = Callable[..., Detection]


def _known(detection: Detection, depth_m: float, size: TargetShape = LETTER, **changes: object) -> KnownDistance:
    values = {"picture": "a.png", "width_px": 640, "height_px": 480, **changes}
    return KnownDistance(detection=detection, size=size, depth_m=depth_m, **values)


def test_what_is_perhaps_the_target_calibrates_only_when_a_person_says_that_it_is(seen_sheet: Seen) -> None:
    seen = replace(seen_sheet(248, 190, MIDDLE), status=DetectionStatus.PERHAPS, reason="a pale rim")
    with pytest.raises(CalibrationError, match=r"a\.png: a pale rim"):
        calibrate([_known(seen, 24 * INCH_M)], date="2026-01-31")
    made = calibrate([_known(seen, 24 * INCH_M, is_confirmed=True)], date="2026-01-31")
    assert made.camera_model.fx_px == pytest.approx(541.09, abs=0.01)


def test_the_model_has_square_pixels_and_the_axis_in_the_middle_and_says_where_it_comes_from(seen_sheet: Seen) -> None:
    model = calibrate([_known(seen_sheet(248, 190, MIDDLE), 24 * INCH_M)], date="2026-01-31").camera_model
    assert (model.width_px, model.height_px, model.cx_px, model.cy_px) == (640, 480, *MIDDLE)
    assert model.fy_px == model.fx_px
    assert (model.provenance.date, model.provenance.method) == ("2026-01-31", "one picture at a known distance")
    (note,) = model.provenance.notes
    assert note == "a.png: 248.00 x 190.00 px at 0.6096 m, F = 541.09 px, reads +0.00%"


@given(away=st.floats(-0.5, 0.5), depth_m=st.floats(0.3, 5.0), radius_m=st.floats(0.01, 0.1))
def test_a_ball_gives_the_true_focal_length_anywhere_in_the_picture(
    camera: CameraModel, seen_ball: Seen, away: float, depth_m: float, radius_m: float
) -> None:
    seen = seen_ball((away * depth_m, 0.2 * depth_m, depth_m), radius_m)
    made = calibrate([_known(seen, depth_m, BallShape(diameter_m=2 * radius_m))], date="")
    assert made.camera_model.fx_px == pytest.approx(camera.fx_px, rel=1e-3)


def test_the_uncertainty_has_the_tapes_part_and_the_pixels_part(seen_sheet: Seen) -> None:
    seen = seen_sheet(100, 77.2, MIDDLE, sigma_px=2.0)
    assert calibrate([_known(seen, 1.0)], date="").camera_model.focal_relative_sigma == pytest.approx(
        math.hypot(0.02, 0.01), rel=1e-3
    )
    exact = calibrate([_known(seen, 1.0)], date="", distance_relative_sigma=0.0)
    assert exact.camera_model.focal_relative_sigma == pytest.approx(0.02, rel=1e-3)


def test_several_pictures_that_agree_are_surer_than_one(seen_sheet: Seen) -> None:
    one = calibrate([_known(seen_sheet(220, 170, MIDDLE), 0.762)], date="")
    four = calibrate([_known(seen_sheet(220 / k, 170 / k, MIDDLE), 0.762 * k) for k in (1, 2, 3, 4)], date="")
    assert four.camera_model.fx_px == pytest.approx(one.camera_model.fx_px)
    assert four.camera_model.focal_relative_sigma < 0.6 * one.camera_model.focal_relative_sigma
    assert four.camera_model.provenance.method == "4 pictures at known distances"
    assert len(four.camera_model.provenance.notes) == 4


def _biased(seen_sheet: Seen, bias_px: float, depth_m: float, depth_error: float = 0.0) -> KnownDistance:
    """A sheet at a focal length of 600 px whose every edge is seen too far out, and what a detector undoes of it."""
    width_px, height_px = (600 * side / depth_m + 2 * bias_px for side in (LETTER.width_m, LETTER.height_m))
    less = 2 * BIAS_STEP_PX
    return _known(
        seen_sheet(width_px, height_px, MIDDLE, sigma_px=0.1),
        depth_m * (1 + depth_error),
        picture=f"{depth_m}.png",
        less_bias=seen_sheet(width_px - less, height_px - less, MIDDLE, sigma_px=0.1),
    )


@pytest.mark.parametrize("bias_px", [0.8, -0.5, 0.0])
def test_near_and_far_pictures_tell_focal_length_and_edge_bias_together(seen_sheet: Seen, bias_px: float) -> None:
    known = [_biased(seen_sheet, bias_px, depth_m) for depth_m in (0.5, 1.0, 2.0, 4.0)]
    made = calibrate(known, date="", distance_relative_sigma=0.003)
    assert made.fit.bias_was_fitted
    assert made.camera_model.fx_px == pytest.approx(600, rel=1e-3)
    assert made.camera_model.edge_bias_px == pytest.approx(bias_px, abs=0.01)
    assert all(abs(each.residual_share) < 1e-3 for each in made.pictures)


def test_the_stated_uncertainty_of_focal_length_and_bias_holds(seen_sheet: Seen) -> None:
    rng = np.random.default_rng(3)
    misses = []
    for _ in range(60):
        errors = rng.normal(0, 0.005, 4)
        known = [_biased(seen_sheet, 0.4, m, error) for m, error in zip((0.5, 1.0, 2.0, 4.0), errors, strict=True)]
        made = calibrate(known, date="", distance_relative_sigma=0.005)
        focal = (made.camera_model.fx_px / 600 - 1) / made.camera_model.focal_relative_sigma
        misses.append((focal, (made.camera_model.edge_bias_px - 0.4) / made.fit.edge_bias_sigma_px))
    assert np.sqrt(np.mean(np.square(misses), axis=0)) == pytest.approx([1.0, 1.0], abs=0.35)


def test_pictures_at_one_distance_leave_the_bias_at_zero_and_say_so(seen_sheet: Seen) -> None:
    made = calibrate([_biased(seen_sheet, 0.8, 1.0), _biased(seen_sheet, 0.8, 1.0)], date="")
    assert made.one_distance
    assert not made.fit.bias_was_fitted
    assert made.camera_model.edge_bias_px == 0.0


def test_a_detector_that_does_not_say_what_a_bias_changes_gets_none(seen_sheet: Seen) -> None:
    known = [replace(_biased(seen_sheet, 0.5, depth_m), less_bias=None) for depth_m in (0.5, 1.0, 2.0, 4.0)]
    made = calibrate(known, date="", distance_relative_sigma=0.003)
    assert (made.fit.bias_was_fitted, made.one_distance) == (False, False)


def test_a_focal_length_that_nobody_could_use_is_refused(seen_sheet: Seen) -> None:
    far_aside = _known(seen_sheet(20, 15, (600, 40), sigma_px=9.0), 1.0)
    with pytest.raises(CalibrationError, match=r"do not tell the focal length: \d+ px ± \d+%"):
        calibrate([far_aside], date="")


def test_a_picture_without_the_target_is_left_out(seen_sheet: Seen) -> None:
    missing = Detection(target="paper", status=DetectionStatus.NOT_FOUND, reason="no contour of four corners")
    made = calibrate([_known(missing, 1.0), _known(seen_sheet(220, 170, MIDDLE), 0.762, picture="b.png")], date="")
    assert [each.picture for each in made.pictures] == ["b.png"]


def test_no_picture_with_the_target_is_an_error_that_says_why(seen_sheet: Seen) -> None:
    cut = Detection(target="paper", status=DetectionStatus.TRUNCATED, reason="the sheet is cut off by the border")
    with pytest.raises(CalibrationError, match=r"none of the pictures: a\.png: the sheet is cut off by the border"):
        calibrate([_known(cut, 1.0)], date="")
    with pytest.raises(CalibrationError, match="there is no picture to calibrate from"):
        calibrate([], date="")


def test_pictures_of_different_resolutions_are_refused(seen_sheet: Seen) -> None:
    seen = seen_sheet(220, 170, MIDDLE)
    with pytest.raises(CalibrationError, match=r"a\.png has 640x480 px, b\.png has 1280x960"):
        calibrate([_known(seen, 1.0), _known(seen, 1.0, picture="b.png", width_px=1280, height_px=960)], date="")


def test_a_camera_inside_the_ball_is_refused(seen_ball: Seen) -> None:
    seen = seen_ball((0.0, 0.0, 1.0), 0.1)
    with pytest.raises(CalibrationError, match="would be inside it"):
        calibrate([_known(seen, 0.09, BallShape(diameter_m=0.2))], date="")


@pytest.mark.parametrize("depth_m", [0.0, -1.0, math.nan, math.inf])
def test_a_distance_that_is_none_is_refused(seen_sheet: Seen, seen_ball: Seen, depth_m: float) -> None:
    ball = _known(seen_ball((0.0, 0.0, 1.0), 0.1), depth_m, BallShape(diameter_m=0.2))
    for known in (_known(seen_sheet(220, 170, MIDDLE), depth_m), ball):
        with pytest.raises(ValueError, match=r"is not a finite number above zero|would be inside it"):
            calibrate([known], date="")


# New pictures at known distances say how wrong a camera model is.

PAPER = SheetShape(width_m=0.297, height_m=0.21)


@pytest.fixture
def known(seen_sheet: Seen) -> Callable[..., KnownDistance]:
    def _known(depth_m: float, stated_m: float | None = None, scale: int = 1) -> KnownDistance:
        seen = seen_sheet(scale * 600 * 0.297 / depth_m, scale * 600 * 0.21 / depth_m, (scale * 320 - 0.5,) * 2)
        return KnownDistance(
            picture=f"{depth_m}.png",
            width_px=640 * scale,
            height_px=480 * scale,
            detection=seen,
            size=PAPER,
            depth_m=stated_m or depth_m,
        )

    return _known


def _check(model: CameraModel, *known: KnownDistance) -> CalibrationCheck:
    return check_calibration(known, model, distance_relative_sigma=0.01)


def test_a_focal_length_that_is_too_long_reads_too_far_in_every_picture(
    camera: CameraModel, known: Callable[..., KnownDistance]
) -> None:
    checked = _check(replace(camera, fx_px=642, fy_px=642), *(known(0.5 + 0.25 * i) for i in range(4)))
    assert checked.bias_is_outside
    assert checked.bias_share == pytest.approx(0.07, rel=1e-3)
    assert not checked.is_sound


def test_the_same_error_is_allowed_to_a_camera_file_that_states_it(
    camera: CameraModel, known: Callable[..., KnownDistance]
) -> None:
    unsure = replace(camera, fx_px=642, fy_px=642, focal_relative_sigma=0.05)
    assert _check(unsure, *(known(0.5 + 0.25 * i) for i in range(4))).is_sound


def test_one_wrong_distance_among_right_ones_is_outside_and_the_mean_is_not(
    camera: CameraModel, known: Callable[..., KnownDistance]
) -> None:
    checked = _check(camera, *(known(0.5 + 0.1 * i) for i in range(7)), known(1.0, stated_m=1.045))
    assert [each.is_outside for each in checked.pictures] == [False] * 7 + [True]
    assert not checked.bias_is_outside
    assert not checked.is_sound


def test_pictures_of_another_resolution_are_measured_at_it(
    camera: CameraModel, known: Callable[..., KnownDistance]
) -> None:
    assert _check(camera, known(1.0, scale=2)).pictures[0].measured_m == pytest.approx(1.0, rel=1e-3)


def _set(seen_sheet: Seen, rng: np.random.Generator, wrong_shares: Sequence[float]) -> list[KnownDistance]:
    """Return a picture for each share that its stated distance is off by; tape and edges err as they are stated to."""
    known = []
    for at, share in enumerate(wrong_shares):
        depth_m = float(rng.uniform(0.5, 3.0))
        px = 600 / depth_m * float(rng.normal(1.0, 0.0005))
        known.append(
            KnownDistance(
                picture=f"{at}.png",
                width_px=640,
                height_px=480,
                detection=seen_sheet(px * 0.297, px * 0.21, (319.5, 239.5)),
                size=PAPER,
                depth_m=depth_m * float(rng.normal(1.0, 0.01)) * (1 + share),
            )
        )
    return known


def _agrees(known: list[KnownDistance]) -> bool:
    try:
        check_agreement(known, distance_relative_sigma=0.01)
    except CalibrationError:
        return False
    return True


def test_two_pictures_of_six_that_say_twice_the_focal_length_are_named(seen_sheet: Seen) -> None:
    known = _set(seen_sheet, np.random.default_rng(1), [0, 0, -0.56, 0, -0.57, 0])
    with pytest.raises(CalibrationError, match=r"Most at odds with the others: (2\.png, 4\.png|4\.png, 2\.png)\.$"):
        check_agreement(known, distance_relative_sigma=0.01)


@pytest.mark.parametrize("sets", [20, pytest.param(300, marks=pytest.mark.long)])
def test_no_set_of_pictures_that_contradict_each_other_passes(seen_sheet: Seen, sets: int) -> None:
    passed = []
    for seed in range(sets):
        rng = np.random.default_rng((seed, 40))
        right, wrong = int(rng.integers(1, 6)), int(rng.integers(1, 4))
        shares = [0.0] * right + [float(rng.choice((-1, 1)) * rng.uniform(0.12, 0.5)) for _ in range(wrong)]
        rng.shuffle(shares)
        if _agrees(_set(seen_sheet, rng, shares)):
            passed.append(seed)
    assert passed == []


@pytest.mark.parametrize("sets", [20, pytest.param(300, marks=pytest.mark.long)])
def test_sets_without_a_mistake_are_refused_in_one_of_a_hundred_at_most(seen_sheet: Seen, sets: int) -> None:
    rngs = [np.random.default_rng((seed, 41)) for seed in range(sets)]
    agree = [_agrees(_set(seen_sheet, rng, [0.0] * int(rng.integers(2, 8)))) for rng in rngs]
    assert agree.count(False) <= sets // 100
