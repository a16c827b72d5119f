from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.simulation.camera import Renderer
from stadimeter.simulation.silhouette import paint_ball, silhouette
from support.each_case import each_case

pytestmark = pytest.mark.vision

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


def test_the_same_arguments_give_the_same_picture_from_two_renderers() -> None:
    one, other = renderer(noise=2.0), renderer(noise=2.0)
    assert np.array_equal(one.render((0, 0.15, 2), 0.1, 0.3, 5), other.render((0, 0.15, 2), 0.1, 0.3, 5))


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
