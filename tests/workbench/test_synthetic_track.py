"""Made-up distances: where a target truly is, and what noise, dropouts and gross errors make of it."""

from __future__ import annotations

import math
from itertools import pairwise
from statistics import fmean, pstdev

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.rule_test_tables import MotionTable, PathPoint, SpanTable
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.similar_triangles import expect
from stadimeter.workbench.rule_tests.inputs import OUTLIER_FACTOR, SensorModel, SyntheticTrack, position_at

CAMERA = CameraModel(
    width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=319.5, cy_px=239.5, focal_relative_sigma=0.02
)
SENSOR = SensorModel(size=BallShape(diameter_m=0.2, relative_sigma=0.01), camera=CAMERA)
_, NOISE_M = SENSOR.sigmas_m(2.0)

distances_m = st.floats(0.1, 10)


def path_of(**motion: object) -> tuple[PathPoint, ...]:
    return MotionTable.model_validate(motion).path()


def measured(path: tuple[PathPoint, ...], frames: int = 2000, seed: int = 1, **nuisances: object) -> list[Measurement]:
    track = SyntheticTrack(target="ball", path=path, sensor=SENSOR, seed=seed, **nuisances)
    return [track.measure(frame / 30) for frame in range(frames)]


def standing(distance_m: float = 2.0) -> tuple[PathPoint, ...]:
    return (PathPoint(at_s=0.0, distance_m=distance_m),)


def distances(measurements: list[Measurement]) -> list[float]:
    return [each.distance_m for each in measurements if each.distance_m is not None]


def test_a_target_that_is_too_small_in_the_picture_is_not_found() -> None:
    assert not distances(measured(standing(41.0), frames=20))
    assert distances(measured(standing(30.0), frames=20))


def test_noise_never_makes_a_distance_near_and_sure() -> None:
    drowned = measured(standing(), noise=1000.0)
    assert min(distances(drowned)) > 0.2 * 2.0
    assert any(each.reason == "lost in the noise" for each in drowned)


def test_a_target_that_approaches_waits_then_goes_evenly_then_stays() -> None:
    path = path_of(approach={"from": "4 m", "to": "1 m", "speed": "2 m/s", "stay": "2 s"})
    assert [position_at(path, at_s).distance_m for at_s in (0, 1, 1.5, 2.5, 3, 9)] == [4, 4, 3, 1, 1, 1]
    assert path[-1].at_s == 4.5


def test_the_noise_is_what_camera_and_target_are_expected_to_have() -> None:
    found = distances(measured(standing(), 20_000, correlation=0.6))
    assert fmean(found) == pytest.approx(2.0, abs=0.1 * NOISE_M)
    assert pstdev(found) == pytest.approx(NOISE_M, rel=0.05)
    errors = [each - 2.0 for each in found]
    correlation = sum(a * b for a, b in pairwise(errors)) / sum(a * a for a in errors)
    assert correlation == pytest.approx(0.6, abs=0.03)


def test_the_stated_sigma_holds_what_is_the_same_in_every_frame_too() -> None:
    (seen,) = measured(standing(), 1, noise=0.0)
    assert seen.distance_m == 2.0
    assert seen.noise_m == NOISE_M
    assert seen.sigma_m == pytest.approx(math.hypot(NOISE_M, 2.0 * 0.02, 2.0 * 0.01))
    without_size_error = SensorModel(size=BallShape(diameter_m=0.2), camera=CAMERA)
    assert without_size_error.sigmas_m(2.0)[0] == pytest.approx(expect(BallShape(diameter_m=0.2), CAMERA, 2.0).sigma_m)


def test_dropouts_and_gross_errors_come_as_often_as_asked() -> None:
    found = measured(standing(), 10_000, dropouts=0.05, outliers=0.02)
    missing = sum(each.status is MeasurementStatus.NOT_FOUND for each in found)
    assert missing == pytest.approx(500, abs=80)
    gross = [each for each in distances(found) if abs(each - 2.0) > 6 * NOISE_M]
    assert len(gross) == pytest.approx(190, abs=50)
    assert all(2.0 / OUTLIER_FACTOR <= each <= 2.0 * OUTLIER_FACTOR for each in gross)


def test_out_of_sight_there_is_nothing_to_measure_and_the_reason_says_so() -> None:
    span = SpanTable.model_validate({"from": "1 s", "for": "0.5 s"})
    found = measured(standing(), 60, lost=[span])
    missing = [index for index, each in enumerate(found) if each.status is MeasurementStatus.NOT_FOUND]
    assert missing == list(range(30, 45))
    assert {found[index].reason for index in missing} == {"out of sight"}
    assert all(each.status is MeasurementStatus.NOT_FOUND for each in measured((), 10))


@given(distances_m, st.integers(0, 50), st.floats(0, 100))
def test_a_distance_is_always_a_number_above_zero(distance_m: float, seed: int, noise: float) -> None:
    for each in distances(measured(standing(distance_m), 20, seed, noise=noise, outliers=0.3)):
        assert math.isfinite(each)
        assert each > 0
