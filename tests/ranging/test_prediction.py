"""Where a target is expected."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.perception.prediction import UNSEEN_MAX_S, AngularMotion, follow, predict
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import DiscShape, SheetShape, TagShape
from stadimeter.ranging.measure import measure
from support.each_case import each_case

pytestmark = pytest.mark.vision

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
BENT = replace(CAMERA, distortion=(-0.25, 0.06, 0.001, -0.002, 0.01))
BALL = BallShape(diameter_m=0.065)


def track(**changes: object) -> Track:
    known = Track(
        target="ball",
        status=TrackStatus.TRACKING,
        distance_m=2.0,
        depth_m=2.0,
        closing_mps=0.0,
        sigma_m=0.01,
        closing_sigma_mps=0.05,
        bearing_rad=0.0,
        elevation_rad=0.0,
        as_of_s=10.0,
        measured_at_s=10.0,
    )
    return replace(known, **changes)


def expected(known: Track, at_s: float = 10.0, size: object = BALL, camera: CameraModel = CAMERA) -> Prediction:
    found = predict(known, size, camera, at_s)
    assert found is not None
    return found


@given(
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.38, 0.38),
    depth_m=st.floats(0.3, 8.0),
    camera=st.sampled_from([CAMERA, BENT]),
)
def test_a_ball_that_was_measured_is_expected_just_where_it_was_seen(
    x: float, y: float, depth_m: float, camera: CameraModel
) -> None:
    """The prediction is the inverse of the measurement, perspective and distortion included."""
    centre_px = camera.pixel(x, y)
    diameter_px = 600 * 0.065 / depth_m
    seen = Detection(
        target="ball", status=DetectionStatus.FOUND, centre_px=centre_px, width_px=diameter_px, height_px=diameter_px
    )
    measured = measure(seen, BALL, camera, 10.0)
    known = track(
        distance_m=measured.distance_m, bearing_rad=measured.bearing_rad, elevation_rad=measured.elevation_rad
    )
    found = predict(known, BALL, camera, 10.0)
    if not (0 <= centre_px[0] <= 639 and 0 <= centre_px[1] <= 479):
        return
    assert found is not None
    assert found.centre_px == pytest.approx(centre_px, abs=1e-6)
    assert found.size_px == pytest.approx(diameter_px, rel=1e-9)


@given(
    start_m=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.floats(1.0, 5.0)),
    across_mps=st.tuples(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4)),
    closing_mps=st.floats(-2.0, 2.0),
    step_s=st.floats(0.0, 0.2),
)
def test_a_moving_ball_appears_within_three_standard_deviations(
    start_m: tuple[float, float, float], across_mps: tuple[float, float], closing_mps: float, step_s: float
) -> None:
    x, y, z = start_m
    away_m = math.sqrt(x * x + y * y + z * z)
    known = track(
        distance_m=away_m,
        closing_mps=closing_mps,
        bearing_rad=math.atan2(x, z),
        elevation_rad=-math.atan2(y, math.hypot(x, z)),
    )
    # It comes nearer along the line of sight, and moves across it, as fast as people walk.
    nearer = 1 - closing_mps * step_s / away_m
    moved = (x * nearer + across_mps[0] * step_s, y * nearer + across_mps[1] * step_s, z * nearer)
    true_px = CAMERA.pixel(moved[0] / moved[2], moved[1] / moved[2])
    found = predict(known, BALL, CAMERA, 10.0 + step_s)
    if found is None:
        return
    assert math.dist(found.centre_px, true_px) < 3 * found.sigma_px
    assert abs(found.size_px - 600 * 0.065 / moved[2]) < 3 * found.sigma_px


def sighted(
    directions_rad: Iterable[tuple[float, float]], frame_s: float = 1 / 30, **changes: object
) -> Iterator[tuple[Track, AngularMotion | None]]:
    """Yield what is known after each frame of a target that is seen in these directions, from 10 s on."""
    motion = None
    for number, (bearing_rad, elevation_rad) in enumerate(directions_rad):
        at_s = 10.0 + number * frame_s
        seen = track(bearing_rad=bearing_rad, elevation_rad=elevation_rad, measured_at_s=at_s, as_of_s=at_s, **changes)
        motion = follow(motion, seen, BALL)
        yield seen, motion


@given(
    start=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    turn_radps=st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
)
def test_a_target_that_moves_evenly_is_expected_where_it_then_is_within_some_pixels(
    start: tuple[float, float], turn_radps: tuple[float, float]
) -> None:
    directions = [(start[0] + turn_radps[0] * n / 30, start[1] + turn_radps[1] * n / 30) for n in range(13)]
    *_, (_, _), (seen, motion) = sighted(directions[:-1])
    found = predict(seen, BALL, CAMERA, 10.0 + 12 / 30, motion)
    bearing_rad, elevation_rad = directions[-1]
    true_px = CAMERA.pixel(math.tan(bearing_rad), -math.tan(elevation_rad) / math.cos(bearing_rad))
    if not (0 < true_px[0] < 639 and 0 < true_px[1] < 479):
        return
    assert found is not None
    assert math.dist(found.centre_px, true_px) < 0.5
    step_px = 600 * math.hypot(*turn_radps) / 30
    assert found.sigma_px < 2 + step_px / 3, "the first step was a surprise, and is nearly forgotten"


def test_a_target_that_starts_to_move_is_less_sure_at_once_and_sure_again_later() -> None:
    rest, motion = [(0.0, 0.0)] * 20, [(0.02 * n, 0.0) for n in range(1, 26)]
    sigmas_px = []
    for seen, known in sighted([*rest, *motion]):
        found = predict(seen, BALL, CAMERA, seen.measured_at_s + 1 / 30, known)
        sigmas_px.append(found.sigma_px if found else math.nan)
    assert sigmas_px[0] > 12, "nothing is known of the motion yet"
    assert sigmas_px[19] < 1.5
    assert sigmas_px[20] == pytest.approx(0.02 * 600, rel=0.05), "it moved by 12 px that nobody expected"
    assert sigmas_px[34] < 2.5


def test_a_target_that_a_hand_waves_about_stays_within_four_standard_deviations() -> None:
    waved = [(0.15 * math.sin(2.5 * n / 30 * math.tau / 2), 0.05 * math.cos(7 * n / 30)) for n in range(120)]
    known = list(sighted(waved))
    for (seen, motion), (then, _) in itertools.pairwise(known[2:]):
        found = predict(seen, BALL, CAMERA, then.measured_at_s, motion)
        true_px = CAMERA.pixel(math.tan(then.bearing_rad), -math.tan(then.elevation_rad) / math.cos(then.bearing_rad))
        assert math.dist(found.centre_px, true_px) < 4 * found.sigma_px


def test_a_target_that_comes_back_after_a_gap_has_no_motion() -> None:
    (seen, motion), *_ = list(sighted([(0.0, 0.0), (0.05, 0.0)]))[1:]
    assert motion.bearing_radps == pytest.approx(1.5)
    later = track(measured_at_s=10.0 + 1 / 30 + UNSEEN_MAX_S + 0.01)
    assert follow(motion, later, BALL).step_s == 0
    assert follow(motion, replace(seen, status=TrackStatus.LOST), BALL) is None
    assert follow(motion, seen, BALL) is motion, "the same sighting tells nothing new"


def test_a_target_that_jumps_is_expected_where_it_is_then_as_if_it_was_new() -> None:
    *_, (before, _), (seen, motion) = sighted([*[(-0.3, 0.0)] * 10, (0.3, 0.1)])
    assert before.bearing_rad == -0.3
    found = predict(seen, BALL, CAMERA, seen.measured_at_s + 1 / 30, motion)
    fresh = predict(seen, BALL, CAMERA, seen.measured_at_s + 1 / 30)
    assert found == fresh


def test_a_motion_does_not_go_on_for_ever() -> None:
    *_, (seen, motion) = sighted([(0.02 * n, 0.0) for n in range(6)])
    soon, late = (predict(seen, BALL, CAMERA, seen.measured_at_s + step_s, motion) for step_s in (2 / 30, 6 / 30))
    assert late.centre_px == pytest.approx(soon.centre_px)
    assert late.sigma_px > 3 * soon.sigma_px


def test_what_errs_in_the_distance_as_in_the_prediction_counts_not() -> None:
    unsure = replace(CAMERA, focal_relative_sigma=0.05)
    assert expected(track(sigma_m=0.1), camera=unsure, size=TagShape(side_m=0.2)).sigma_px < 2
    assert expected(track(sigma_m=0.1), camera=CAMERA, size=TagShape(side_m=0.2)).sigma_px > 2.5


@pytest.mark.parametrize(
    ("size", "longest_m"),
    [
        (SheetShape(width_m=0.28, height_m=0.22), 0.28),
        (SheetShape(width_m=0.1, height_m=0.2), 0.2),
        (TagShape(side_m=0.08), 0.08),
        (DiscShape(diameter_m=0.05), 0.05),
    ],
)
def test_of_something_flat_the_longer_side_is_expected(size: object, longest_m: float) -> None:
    assert expected(track(), size=size).size_px == pytest.approx(600 * longest_m / 2.0)


@each_case(
    "changes",
    [
        {"status": TrackStatus.SEARCHING},
        {"status": TrackStatus.LOST},
        {"measured_at_s": 10.0 - UNSEEN_MAX_S - 0.01},
        {"measured_at_s": 10.1},
        {"measured_at_s": None},
        {"as_of_s": None},
        {"distance_m": None},
        {"bearing_rad": None},
        {"elevation_rad": None},
        {"sigma_m": None},
        {"bearing_rad": math.pi / 2},
        {"elevation_rad": -2.0},
        {"bearing_rad": 0.6},
        {"elevation_rad": 0.5},
        {"sigma_m": 1.5, "distance_m": 0.1},
        {"distance_m": 0.03},
        {"distance_m": 0.0},
        {"distance_m": -1.0},
    ],
)
def test_nothing_is_expected_of_what_is_not_known_or_not_in_the_picture(changes: dict[str, object]) -> None:
    assert predict(track(**changes), BALL, CAMERA, 10.0) is None


@given(
    name=st.sampled_from(["distance_m", "sigma_m", "bearing_rad", "elevation_rad", "closing_mps", "closing_sigma_mps"]),
    value=st.floats(allow_nan=True, allow_infinity=True),
    size=st.sampled_from([BALL, TagShape(side_m=0.08)]),
    camera=st.sampled_from([CAMERA, BENT]),
)
def test_whatever_a_figure_is_the_prediction_is_finite_or_none(
    name: str, value: float, size: object, camera: CameraModel
) -> None:
    found = predict(track(**{name: value}), size, camera, 10.05)
    if found is not None:
        assert all(math.isfinite(each) for each in (*found.centre_px, found.size_px, found.sigma_px))
        assert found.size_px > 0
        assert found.sigma_px > 0
