"""The simulated camera: what it draws, and the detector that knows the truth."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from stadimeter.config.plugins import CAMERAS, DETECTORS
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.errors import CalibrationError, CaptureTimeoutError, ConfigError
from stadimeter.ranging.ball import BallShape
from stadimeter.simulation.camera import Renderer, SimulatedCameraOptions, hits, paint_ball, silhouette
from support.each_case import each_case

pytestmark = pytest.mark.vision


SMALL = CameraModel.with_focal_length(150.0, 160, 120)


@pytest.fixture
def small(make_run):
    """Return a run through a small lens, which draws quickly."""
    return make_run(lens=SMALL)


def opened(run, **options):
    camera = run.build(CAMERAS, **options)
    camera.open()
    return camera


def test_reading_moves_the_clock_from_frame_to_frame(small) -> None:
    camera = opened(small, rate="20 Hz")
    frames = [camera.read() for _ in range(3)]
    assert [frame.captured_at_s for frame in frames] == pytest.approx([100.05, 100.1, 100.15])
    assert [frame.sequence for frame in frames] == [0, 1, 2]
    assert small.clock.now_s() == frames[-1].captured_at_s


def test_a_picture_shows_the_ball_where_it_truly_is_at_its_time(make_run) -> None:
    run = make_run(path=[{"at": "0 s", "x": "1.5 m", "y": "-1 m"}, {"at": "4 s", "x": "2 m", "y": "1 m"}], loop=False)
    run.world.robot.drive_wheels(0.02, 0.05)
    camera = opened(run, rate="2 Hz")
    for _ in range(6):
        frame = camera.read()
        hsv = cv2.cvtColor(frame.image, cv2.COLOR_BGR2HSV)
        moments = cv2.moments(cv2.inRange(hsv, (29, 86, 6), (64, 255, 255)), binaryImage=True)
        seen = silhouette(run.lens, run.world.target_in_camera(frame.captured_at_s), 0.1)
        left, top, right, bottom = seen.extent_px
        if left > 0 and right < 639:
            centre_px = (moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])
            assert centre_px == pytest.approx(seen.centre_px, abs=0.4)
            assert moments["m00"] == pytest.approx(np.pi / 4 * (right - left) * (bottom - top), rel=0.05)
    assert left > 0, "the last frame at least must show the whole ball"


def test_without_rendering_frames_are_black_and_share_one_picture_that_cannot_be_written(small) -> None:
    camera = opened(small, render=False)
    first, second = camera.read(), camera.read()
    assert first.image is second.image
    assert first.image.shape == (120, 160, 3)
    assert not first.image.any()
    with pytest.raises(ValueError, match="read-only"):
        first.image[0, 0] = 1


def test_a_frozen_camera_delivers_the_same_old_frame_while_time_passes(small) -> None:
    camera = opened(small, rate="10 Hz")
    last = camera.read()
    small.world.faults.camera_frozen = True
    for _ in range(5):
        assert camera.read() is last
    assert small.clock.now_s() == pytest.approx(last.captured_at_s + 0.5)
    small.world.faults.camera_frozen = False
    next_frame = camera.read()
    assert next_frame.captured_at_s == pytest.approx(last.captured_at_s + 0.6)
    assert next_frame.sequence == last.sequence + 6


def test_a_blocked_camera_lets_time_pass_and_says_so(small) -> None:
    camera = opened(small, rate="10 Hz")
    small.world.faults.camera_blocked = True
    with pytest.raises(CaptureTimeoutError, match="blocked"):
        camera.read()
    assert small.clock.now_s() == pytest.approx(100.1)
    small.world.faults.camera_blocked = False
    assert camera.read().captured_at_s >= 100.1


def test_frames_that_nobody_read_in_time_are_passed_over(small) -> None:
    camera = opened(small, rate="10 Hz")
    camera.read()
    small.clock.advance_s(1.04)
    late = camera.read()
    assert late.captured_at_s == pytest.approx(101.2)
    assert late.sequence == 11
    assert small.clock.now_s() == pytest.approx(101.2)


@pytest.mark.parametrize("options", [{"rate": "0 Hz"}, {"rate": "30"}, {"noise": -1}, {"noise": "nan"}, {"fps": 30}])
def test_a_wrong_option_is_refused(options) -> None:
    with pytest.raises(ValidationError):
        SimulatedCameraOptions.model_validate(options)


LENS = CameraModel.with_focal_length(600.0, 640, 480)
OBLONG = CameraModel(width_px=640, height_px=480, fx_px=500.0, fy_px=700.0, cx_px=300.0, cy_px=260.0)
BALL_RANGE = ((29, 86, 6), (64, 255, 255))


def renderer(lens: CameraModel = LENS, *, noise: float = 0.0, seed: int = 1, height_m: float = 0.25) -> Renderer:
    return Renderer(lens, camera_height_m=height_m, seed=seed, noise=noise)


def mask_of_the_ball(image: Image) -> NDArray[np.uint8]:
    return cv2.inRange(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), *BALL_RANGE)


def cover_of(lens: CameraModel, ball_m: tuple[float, float, float], radius_m: float) -> NDArray[np.float32]:
    """Return how much of each pixel the ball covers.

    It is painted on black and on white: the difference between the two is what is left of the backdrop.
    """
    black, white = np.zeros((480, 640, 3), np.uint8), np.full((480, 640, 3), 255, np.uint8)
    for backdrop in (black, white):
        paint_ball(backdrop, lens, ball_m, radius_m)
    left = white.astype(np.float32) - black.astype(np.float32)
    return 1 - left.mean(axis=2) / 255


def edge_errors_px(lens: CameraModel, ball_m: tuple[float, float, float], radius_m: float) -> NDArray[np.float64]:
    """Walk across the limb in many directions and return how much further out than the exact cone it is."""
    seen = silhouette(lens, ball_m, radius_m)
    assert seen is not None
    angles = np.linspace(0, 2 * math.pi, 90, endpoint=False)
    limb = seen.outline_px(np.stack((np.cos(angles), np.sin(angles)), axis=1))
    outwards = limb - seen.centre_px
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    steps = np.linspace(-2, 2, 81)
    walk = (limb[:, None, :] + outwards[:, None, :] * steps[None, :, None]).astype(np.float32)
    profiles = cv2.remap(cover_of(lens, ball_m, radius_m), walk[..., 0], walk[..., 1], cv2.INTER_LINEAR)
    # The cover along a walk adds up to the length of its part inside the ball.
    inside_px = (profiles[:, 1:] + profiles[:, :-1]).sum(axis=1) / 2 * (steps[1] - steps[0])
    return inside_px - 2


@each_case("lens", [LENS, OBLONG], ids=["square pixels", "oblong pixels"])
@each_case(
    ("ball_m", "radius_m"),
    [
        ((0.0, 0.0, 1.0), 0.1),
        ((0.013, -0.027, 3.0), 0.1),
        ((0.6, 0.25, 1.6), 0.1),
        ((-0.31, 0.1, 1.0), 0.15),
        ((0.1, 0.0, 0.5), 0.1),
    ],
    ids=["on the axis", "far", "in a corner", "wide off", "near"],
)
def test_the_limb_is_where_the_exact_cone_has_it(
    lens: CameraModel, ball_m: tuple[float, float, float], radius_m: float
) -> None:
    errors = edge_errors_px(lens, ball_m, radius_m)
    assert abs(errors.mean()) < 0.02
    assert np.abs(errors).max() < 0.1


@each_case("lens", [LENS, OBLONG], ids=["square pixels", "oblong pixels"])
@each_case("depth_m", [0.4, 1.0, 2.7, 6.0, 15.0, 40.0, 120.0])
def test_the_ball_covers_the_area_of_the_exact_cone_however_far_it_is(lens: CameraModel, depth_m: float) -> None:
    ball_m = (0.05, 0.01 * depth_m, depth_m)
    seen = silhouette(lens, ball_m, 0.1)
    assert seen is not None
    exact_px = 2 * math.sqrt(seen.half_across_px[0] * seen.half_along_px[1])
    assert 2 * math.sqrt(cover_of(lens, ball_m, 0.1).sum() / math.pi) == pytest.approx(exact_px, abs=0.02)


@pytest.mark.parametrize("ball_m", [(0.0, 0.15, 1.0), (0.5, 0.15, 2.0), (-0.9, 0.15, 3.0), (0.05, 0.15, 4.0)])
def test_the_ball_found_by_its_colour_has_the_true_place_and_size(ball_m: tuple[float, float, float]) -> None:
    seen = silhouette(LENS, ball_m, 0.1)
    assert seen is not None
    room = renderer(noise=2.0)
    for heading_rad in np.arange(0, 6.2, 1.4):
        mask = mask_of_the_ball(room.render(ball_m, 0.1, heading_rad))
        moments = cv2.moments(mask, binaryImage=True)
        centre_px = (moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])
        across_px = 2 * math.sqrt(moments["m00"] / math.pi)
        assert centre_px == pytest.approx(seen.centre_px, abs=0.35)
        assert across_px == pytest.approx(2 * math.sqrt(seen.half_across_px[0] * seen.half_along_px[0]), abs=1.0)


@pytest.mark.parametrize("seed", range(2))
def test_nothing_else_in_the_room_has_the_balls_colour(seed: int) -> None:
    room = renderer(noise=2.0, seed=seed)
    headings = np.arange(0, 2 * math.pi, 0.5)
    assert sum(cv2.countNonZero(mask_of_the_ball(room.render(None, 0.1, heading))) for heading in headings) == 0


def test_turning_left_moves_the_room_to_the_right_by_the_lens_own_measure() -> None:
    room = renderer()
    before = room.render(None, 0.1, 0.0)[:, 270:370].astype(np.float32)
    after = room.render(None, 0.1, 0.05).astype(np.float32)
    place = cv2.minMaxLoc(cv2.matchTemplate(after, before, cv2.TM_SQDIFF))[2]
    assert place[0] - 270 == pytest.approx(600 * 0.05, abs=2)


def test_the_noise_differs_from_frame_to_frame_and_is_as_strong_as_asked() -> None:
    quiet, noisy = renderer(noise=0.0), renderer(noise=5.0)
    clean = quiet.render(None, 0.1, 0.0).astype(float)
    first, second = (noisy.render(None, 0.1, 0.0, sequence).astype(float) - clean for sequence in (0, 1))
    assert first.std() == pytest.approx(5.0, rel=0.03)
    assert abs(first.mean()) < 0.05
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02


@pytest.mark.parametrize(
    "ball_m",
    [(0.0, 0.0, -2.0), (9.0, 0.0, 1.0), (0.0, 0.0, -0.101), (0.0, -4.0, 1.0)],
    ids=["behind", "far right", "at the back of the head", "above"],
)
def test_a_ball_out_of_view_is_not_drawn(ball_m: tuple[float, float, float]) -> None:
    room = renderer()
    assert not mask_of_the_ball(room.render(ball_m, 0.1, 0.0)).any()


def test_a_ball_that_touches_the_lens_plane_is_cut_off_and_drawn_all_the_same() -> None:
    mask = mask_of_the_ball(renderer().render((0.12, 0.0, 0.09), 0.1, 0.0))
    assert mask[:, -1].all()
    assert not mask[:, 0].any()


@pytest.mark.parametrize(
    "lens",
    [
        CameraModel.with_focal_length(100.0, 640, 480),
        CameraModel.with_focal_length(2600.0, 1920, 1080),
        CameraModel.with_focal_length(60.0, 64, 48),
        CameraModel(width_px=640, height_px=480, fx_px=600, fy_px=600, cx_px=319.5, cy_px=0.0),
    ],
    ids=["very wide", "long and large", "thumbnail", "looking down"],
)
def test_other_lenses_work_too(lens: CameraModel) -> None:
    image = renderer(lens, noise=2.0).render((0.0, 0.15, 1.0), 0.1, 0.4)
    assert image.shape == (lens.height_px, lens.width_px, 3)
    assert image.std() > 5


ANGLES = np.linspace(0, 2 * math.pi, 40, endpoint=False)
CIRCLE = np.stack((np.cos(ANGLES), np.sin(ANGLES)), axis=1)

balls = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.5, 10))
radii = st.floats(0.01, 0.3)
lenses = st.sampled_from([LENS, OBLONG])


def test_a_ball_on_the_axis_is_a_circle_of_the_cones_size() -> None:
    seen = silhouette(LENS, (0.0, 0.0, 2.0), 0.1)
    expected_px = 600 * math.tan(math.asin(0.1 / 2.0))
    assert seen is not None
    assert seen.centre_px == (LENS.cx_px, LENS.cy_px)
    assert seen.half_across_px == pytest.approx((expected_px, expected_px))
    assert seen.half_along_px == pytest.approx((expected_px, expected_px))


@given(lens=lenses, ball=balls, radius=radii)
def test_the_rays_through_the_outline_touch_the_ball(
    lens: CameraModel, ball: tuple[float, float, float], radius: float
) -> None:
    seen = silhouette(lens, ball, radius)
    assert seen is not None
    for x_px, y_px in seen.outline_px(CIRCLE):
        ray = np.array((*lens.direction(x_px, y_px), 1.0))
        nearest_m = np.linalg.norm(np.cross(ray / np.linalg.norm(ray), ball))
        assert nearest_m == pytest.approx(radius, rel=1e-6)


@given(lens=lenses, ball=balls, radius=radii)
def test_the_extent_is_that_of_the_outline(lens: CameraModel, ball: tuple[float, float, float], radius: float) -> None:
    seen = silhouette(lens, ball, radius)
    assert seen is not None
    fine = np.linspace(0, 2 * math.pi, 4000)
    outline = seen.outline_px(np.stack((np.cos(fine), np.sin(fine)), axis=1))
    size_px = max(seen.half_along_px)
    assert (*outline.min(axis=0), *outline.max(axis=0)) == pytest.approx(seen.extent_px, abs=1e-5 * size_px)


@given(ball=balls, radius=radii)
def test_the_minor_axis_gives_the_depth_by_similar_triangles_but_for_the_radius(
    ball: tuple[float, float, float], radius: float
) -> None:
    seen = silhouette(LENS, ball, radius)
    assert seen is not None
    assert math.hypot(600 * radius / seen.half_across_px[0], radius) == pytest.approx(ball[2])


@given(lens=lenses, ball=balls, radius=radii)
def test_a_ray_hits_inside_the_outline_and_misses_outside(
    lens: CameraModel, ball: tuple[float, float, float], radius: float
) -> None:
    seen = silhouette(lens, ball, radius)
    assert seen is not None
    assert all(hits(lens.direction(*point), ball, radius) for point in seen.outline_px(CIRCLE, 0.999))
    assert not any(hits(lens.direction(*point), ball, radius) for point in seen.outline_px(CIRCLE, 1.001))


@pytest.mark.parametrize("depth_m", [-3.0, 0.0, 0.05, 0.1])
def test_a_ball_not_wholly_in_front_has_no_ellipse(depth_m: float) -> None:
    assert silhouette(LENS, (0.3, 0.0, depth_m), 0.1) is None


def test_a_ball_behind_is_not_hit() -> None:
    assert not hits((0.0, 0.0), (0.0, 0.0, -2.0), 0.1)


BLANK = np.zeros((480, 640, 3), np.uint8)


def ball_at(x: str, y: str, **more):
    return {"path": [{"at": "0 s", "x": x, "y": y}], "camera_height": "25 cm", "ball_height": "25 cm", **more}


def detect(run, sequence: int = 0, **options):
    detector = run.build(DETECTORS, "ideal", name="ball", **options)
    return detector.detect(Frame(BLANK, run.clock.now_s(), sequence))


def test_without_noise_the_ball_is_where_the_truth_says(make_run) -> None:
    found = detect(make_run(**ball_at("2 m", "-0.4 m")), noise_px=0)
    assert found.status is DetectionStatus.FOUND
    assert found.target == "ball"
    assert found.reason == ""
    assert found.width_px == found.height_px == pytest.approx(2 * 600 * 0.1 / math.sqrt(2**2 - 0.1**2))
    assert found.centre_px[0] == pytest.approx(319.5 + 600 * 0.4 * 2 / (2**2 - 0.1**2))
    assert found.centre_px[1] == pytest.approx(239.5)
    assert found.size_sigma_px == 0


def test_the_outline_is_the_balls_limb(make_run) -> None:
    run = make_run(**ball_at("2 m", "-0.4 m"))
    found = detect(run, noise_px=0)
    assert len(found.outline_px) >= 8
    for x_px, y_px in found.outline_px:
        ray = np.array((*run.lens.direction(x_px, y_px), 1.0))
        assert np.linalg.norm(np.cross(ray / np.linalg.norm(ray), (0.4, 0.0, 2.0))) == pytest.approx(0.1)


def test_the_noise_is_as_large_as_asked_and_told(make_run) -> None:
    run = make_run(**ball_at("2 m", "-0.4 m"))
    exact = detect(run, noise_px=0)
    detector = run.build(DETECTORS, "ideal", noise_px=0.5)
    found = [detector.detect(Frame(BLANK, 100.0, sequence)) for sequence in range(4000)]
    errors = np.array([(one.width_px - exact.width_px, *np.subtract(one.centre_px, exact.centre_px)) for one in found])
    assert errors.std(axis=0) == pytest.approx([0.5] * 3, rel=0.05)
    assert np.abs(errors.mean(axis=0)).max() < 0.04
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.06
    assert {one.size_sigma_px for one in found} == {0.5}


def test_a_hidden_ball_is_not_found(run) -> None:
    run.world.faults.target_hidden = True
    hidden = detect(run)
    assert (hidden.status, hidden.reason) == (DetectionStatus.NOT_FOUND, "the ball is hidden")


@pytest.mark.parametrize(
    ("x", "y"), [("-2 m", "0 m"), ("2 m", "3 m"), ("2 m", "-3 m"), ("0 m", "2 m"), ("-5 cm", "0 m")]
)
def test_a_ball_out_of_view_is_not_found(make_run, x: str, y: str) -> None:
    gone = detect(make_run(**ball_at(x, y)))
    assert (gone.status, gone.reason) == (DetectionStatus.NOT_FOUND, "the ball is out of view")


@pytest.mark.parametrize(
    ("x", "y", "border"),
    [
        ("2 m", "1.05 m", "left"),
        ("2 m", "-1.05 m", "right"),
        ("2 m", "1.12 m", "left"),
        ("15 cm", "0 m", "left and top and right and bottom"),
        ("9 cm", "-12 cm", "whole"),
    ],
)
def test_a_ball_cut_off_by_the_border_is_truncated_and_has_no_size(make_run, x: str, y: str, border: str) -> None:
    cut = detect(make_run(**ball_at(x, y)))
    assert cut.status is DetectionStatus.TRUNCATED
    assert cut.reason == f"cut off by the {border} border of the picture"
    assert cut.width_px == 0.0
    assert not len(cut.outline_px)


def test_a_ball_too_far_to_see_is_not_found_and_the_reason_has_the_figures(make_run) -> None:
    far = detect(make_run(**ball_at("60 m", "0 m")), noise_px=0)
    assert (far.status, far.reason) == (DetectionStatus.NOT_FOUND, "a ball of 2.0 px, limit 3.0 px")


def test_a_frame_of_another_resolution_is_looked_at_through_the_same_lens(make_run) -> None:
    run = make_run(**ball_at("2 m", "0 m"))
    detector = run.build(DETECTORS, "ideal", noise_px=0)
    half = detector.detect(Frame(BLANK[:240, :320], 100.0, 0))
    assert half.width_px == pytest.approx(detector.detect(Frame(BLANK, 100.0, 0)).width_px / 2)
    with pytest.raises(CalibrationError):
        detector.detect(Frame(BLANK[:, :320], 100.0, 0))


def test_the_size_is_the_worlds_unless_the_same_is_stated(make_run) -> None:
    run = make_run(ball_diameter="20 cm")
    assert run.build(DETECTORS, "ideal").target_shape == BallShape(diameter_m=0.2)
    assert run.build(DETECTORS, "ideal", diameter="200 mm").target_shape == BallShape(diameter_m=0.2)
    with pytest.raises(ConfigError, match=r"diameter is 0\.067 m, but the ball in \[world\] has 0\.2 m"):
        run.build(DETECTORS, "ideal", diameter="6.7 cm")


@pytest.mark.long
def test_the_real_ball_detector_sees_in_the_drawn_picture_what_the_ideal_one_says(run) -> None:
    camera = run.build(CAMERAS, rate="2 Hz")
    ideal = run.build(DETECTORS, "ideal", noise_px=0)
    real = run.build(DETECTORS, "ball", diameter="20 cm", hsv="29,86,6:64,255,255")
    camera.open()
    for _ in range(36):
        frame = camera.read()
        said, seen = ideal.detect(frame), real.detect(frame)
        assert seen.status is said.status is DetectionStatus.FOUND
        assert seen.width_px == pytest.approx(said.width_px, abs=1.0)
        assert seen.centre_px == pytest.approx(said.centre_px, abs=0.5)
