"""When the whole frame is searched."""

from __future__ import annotations

import itertools

import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.perception.prediction import SEARCH_EVERY_S, Expectations
from stadimeter.ranging.ball import BallShape

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
BALL = BallShape(diameter_m=0.065)


def seen(at_s: float, target: str = "ball", status: TrackStatus = TrackStatus.TRACKING) -> Track:
    return Track(
        target=target,
        status=status,
        distance_m=2.0,
        sigma_m=0.01,
        bearing_rad=0.0,
        elevation_rad=0.0,
        as_of_s=at_s,
        measured_at_s=at_s,
    )


def test_a_tracked_target_is_looked_for_in_the_whole_frame_once_a_second_only() -> None:
    expectations = Expectations()
    times_s = [number / 30 for number in range(300)]
    searched_s = [at_s for at_s in times_s if expectations.of(seen(at_s - 1 / 30), BALL, CAMERA, at_s) is None]
    assert len(searched_s) == 10
    assert min(after - before for before, after in itertools.pairwise(searched_s)) >= SEARCH_EVERY_S


def test_a_slow_camera_searches_every_frame_that_is_a_second_later() -> None:
    expectations = Expectations()
    assert all(expectations.of(seen(at_s - 0.4), BALL, CAMERA, at_s) is None for at_s in (0.0, 1.0, 2.0, 3.0))


def test_a_target_that_is_searched_for_anyway_is_not_searched_for_again_soon() -> None:
    expectations = Expectations()
    assert expectations.of(seen(0.0), BALL, CAMERA, 0.0) is None
    assert expectations.of(seen(0.9, status=TrackStatus.LOST), BALL, CAMERA, 0.9) is None
    assert expectations.of(seen(1.4), BALL, CAMERA, 1.5) is not None


def test_each_target_has_its_own_time() -> None:
    expectations = Expectations()
    assert expectations.of(seen(0.0, "left"), BALL, CAMERA, 0.0) is None
    assert expectations.of(seen(0.5, "right"), BALL, CAMERA, 0.5) is None
    assert expectations.of(seen(0.5, "left"), BALL, CAMERA, 0.6) is not None
    assert expectations.of(seen(1.0, "left"), BALL, CAMERA, 1.1) is None
    assert expectations.of(seen(1.0, "right"), BALL, CAMERA, 1.1) is not None


def test_nothing_is_expected_of_a_target_without_a_track() -> None:
    assert Expectations().of(None, BALL, CAMERA, 0.0) is None


@pytest.mark.parametrize("back_s", [0.1, 100.0])
def test_a_recording_that_starts_over_is_searched_whole(back_s: float) -> None:
    expectations = Expectations()
    expectations.of(seen(200.0), BALL, CAMERA, 200.0)
    assert expectations.of(seen(200.0 - back_s), BALL, CAMERA, 200.0 - back_s) is None
