"""The simulated camera: what it draws, and the detector that knows the truth."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from stadimeter.config.plugins import CAMERAS, DETECTORS
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.errors import CaptureTimeoutError
from stadimeter.simulation.camera import Renderer, paint_ball, silhouette
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


BLANK = np.zeros((480, 640, 3), np.uint8)


def ball_at(x: str, y: str, **more):
    return {"path": [{"at": "0 s", "x": x, "y": y}], "camera_height": "25 cm", "ball_height": "25 cm", **more}


def detect(run, sequence: int = 0, **options):
    detector = run.build(DETECTORS, "ideal", name="ball", **options)
    return detector.detect(Frame(BLANK, run.clock.now_s(), sequence))


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
