"""New pictures at known distances say how wrong a camera model is."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.errors import CalibrationError
from stadimeter.ranging.calibration import CalibrationCheck, KnownDistance, check_calibration, split_outliers
from stadimeter.ranging.flat import SheetShape

PAPER = SheetShape(width_m=0.297, height_m=0.21)
Seen = Callable[..., Detection]


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


def test_a_right_camera_file_is_sound(camera: CameraModel, known: Callable[..., KnownDistance]) -> None:
    checked = _check(camera, known(1.0), known(2.0))
    assert checked.is_sound
    assert checked.bias_share == pytest.approx(0, abs=1e-6)


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


def _judge(known: list[KnownDistance]) -> set[str] | None:
    """Return the names of the outliers; None for a refusal."""
    try:
        return {each.picture for each in split_outliers(known, distance_relative_sigma=0.01)[1]}
    except CalibrationError:
        return None


def test_two_pictures_of_six_that_say_twice_the_focal_length_are_the_outliers(seen_sheet: Seen) -> None:
    known = _set(seen_sheet, np.random.default_rng(1), [0, 0, -0.56, 0, -0.57, 0])
    kept, outliers = split_outliers(known, distance_relative_sigma=0.01)
    assert [each.picture for each in outliers] == ["2.png", "4.png"]
    assert [each.picture for each in kept] == ["0.png", "1.png", "3.png", "5.png"]


@pytest.mark.parametrize("wrong", [[0, 0.2], [0, 0, 0.2, 0.2], [0, 0.2, 0.45]])
def test_where_no_majority_agrees_the_two_that_differ_most_are_named(seen_sheet: Seen, wrong: list[float]) -> None:
    with pytest.raises(CalibrationError, match=r"png and \d\.png contradict each other: their focal lengths are"):
        split_outliers(_set(seen_sheet, np.random.default_rng(2), wrong), distance_relative_sigma=0.01)


@pytest.mark.parametrize("sets", [20, pytest.param(300, marks=pytest.mark.long)])
def test_no_set_of_pictures_that_contradict_each_other_passes_without_an_outlier(seen_sheet: Seen, sets: int) -> None:
    passed = []
    for seed in range(sets):
        rng = np.random.default_rng((seed, 40))
        right, wrong = int(rng.integers(1, 6)), int(rng.integers(1, 4))
        shares = [0.0] * right + [float(rng.choice((-1, 1)) * rng.uniform(0.12, 0.5)) for _ in range(wrong)]
        rng.shuffle(shares)
        if _judge(_set(seen_sheet, rng, shares)) == set():
            passed.append(seed)
    assert passed == []


@pytest.mark.parametrize("sets", [20, pytest.param(300, marks=pytest.mark.long)])
def test_sets_without_a_mistake_are_refused_or_lose_a_picture_in_one_of_a_hundred_at_most(
    seen_sheet: Seen, sets: int
) -> None:
    rngs = [np.random.default_rng((seed, 41)) for seed in range(sets)]
    judged = [_judge(_set(seen_sheet, rng, [0.0] * int(rng.integers(2, 8)))) for rng in rngs]
    assert sum(each != set() for each in judged) <= sets // 100


def test_nothing_to_check_with_is_an_error(camera: CameraModel) -> None:
    with pytest.raises(CalibrationError, match="there is no picture to check with"):
        _check(camera)
