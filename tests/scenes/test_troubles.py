"""Each trouble does to the picture what it says."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from support.each_case import each_case
from support.scenes.backdrop import ClutterBackdrop
from support.scenes.ball import BallTarget
from support.scenes.blur import Blur
from support.scenes.draw import ball_scene
from support.scenes.nuisances import distractors
from support.scenes.occluder import Occluder
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.sensor import Sensor
from support.scenes.tone import Tone

pytestmark = pytest.mark.vision

LENS = CameraModel.with_focal_length(600.0, 640, 480)
FACING = Pose(position_m=(0.0, 0.0, 1.0))


@pytest.mark.parametrize(("tone", "code"), [(Tone.SRGB, 188), (Tone.LINEAR, 128), (Tone.GAMMA_1_8, 173)])
def test_a_pixel_half_covered_by_white_has_the_code_value_of_half_the_light(bare, sheet, tone, code) -> None:
    # The right edge goes through the middle of column 400.
    right_m = (400 - 319.5) / 600
    target = sheet(Pose(position_m=(right_m - 0.1, 0.0, 1.0)), 0.2, 0.2)
    image = render(bare(target, sensor=Sensor(noise=0.0, tone=tone))).image
    assert image[240, 398:403, 1].tolist() == [255, 255, code, 0, 0]


def test_a_trouble_keeps_the_target_and_the_clutter() -> None:
    scene = ball_scene(7)
    quiet, noisy = (render(replace(scene, sensor=Sensor(noise=level))).image.astype(float) for level in (0.0, 8.0))
    difference = noisy - quiet
    inside = (quiet > 40) & (quiet < 215)
    assert difference[inside].std() == pytest.approx(8.0, rel=0.02)
    assert abs(difference[inside].mean()) < 0.05


@pytest.mark.parametrize("sigma_px", [0.7, 1.2, 2.5])
def test_the_point_spread_has_its_standard_deviation(bare, sheet, spread, sigma_px) -> None:
    scene = bare(sheet(FACING), blur=Blur(sigma_px=sigma_px))
    # A pixel is a square of its own, whose variance is 1/12, and so is the step from one to the next.
    assert spread(scene, across=True) == pytest.approx(math.hypot(sigma_px, math.sqrt(1 / 6)), abs=0.03)


def test_motion_blurs_along_its_direction_only(bare, sheet, spread) -> None:
    scene = bare(sheet(FACING), blur=Blur(sigma_px=0.7, motion_px=10.0, direction_rad=0.0))
    still = spread(replace(scene, blur=Blur()), across=True)
    assert spread(scene, across=True) == pytest.approx(math.hypot(still, 10 / math.sqrt(12)), abs=0.05)
    assert spread(scene, across=False) == pytest.approx(still, abs=0.03)


@pytest.mark.parametrize("blur", [Blur(), Blur(motion_px=9.0, direction_rad=0.6)], ids=["point spread", "motion"])
def test_the_patch_around_a_target_has_no_seam(bare, ball, blur) -> None:
    backdrop = ClutterBackdrop()
    scene = bare(ball((0.02, 0.01, 2.0), 0.067), backdrop=backdrop, blur=blur)
    with_ball, empty = render(scene).image.astype(int), render(replace(scene, target=None)).image.astype(int)
    centre, radius = render(scene).truth.outline_px.mean(axis=0), 11.0
    rows, columns = np.indices(with_ball.shape[:2])
    away = np.hypot(columns - centre[0], rows - centre[1]) > radius + blur.reach_px + 1
    assert np.abs(with_ball - empty)[away].max() <= 1


@pytest.mark.parametrize(("share", "from_rad"), [(0.1, 0.0), (0.4, 2.1)])
def test_an_occluder_hides_its_share_of_the_target(bare, ball, cover, share, from_rad) -> None:
    scene = bare(ball((0.1, 0.05, 1.0), 0.2))
    board = Occluder(share=share, from_rad=from_rad, bgr=(0, 0, 0))
    visible = cover(replace(scene, occluder=board)).sum() / cover(scene).sum()
    assert visible == pytest.approx(1 - share, abs=0.002)


def test_distractors_have_the_targets_colour_and_keep_away_from_it() -> None:
    def of_the_colour(scene: Scene) -> np.ndarray:
        hsv = cv2.cvtColor(render(scene).image, cv2.COLOR_BGR2HSV)
        return cv2.inRange(hsv, (34, 180, 150), (40, 210, 255)) > 0

    scene = ball_scene(2)
    more = of_the_colour(distractors(12)(scene)) & ~of_the_colour(scene)
    assert more.sum() > 200
    outline = render(scene).truth.outline_px
    rows, columns = np.indices(more.shape)
    off = np.hypot(columns - outline[:, 0].mean(), rows - outline[:, 1].mean())
    assert off[more].min() > 1.2 * np.ptp(outline[:, 0]) / 2


@each_case(
    "wrong",
    [
        lambda: BallTarget(position_m=(0, 0, 0.05), diameter_m=0.2),
        lambda: BallTarget(position_m=(0, 0, 1.0), diameter_m=float("nan")),
        lambda: Pose(position_m=(0, 0, -1.0)),
        lambda: Pose(position_m=(0, 0, 1.0), tilt_rad=1.6),
        lambda: SheetTarget(pose=FACING, width_m=0.2, height_m=0.0),
        lambda: DiscTarget(pose=FACING, diameter_m=float("inf")),
        lambda: TagTarget(pose=FACING, side_m=0.1, number=587),
        lambda: TagTarget(pose=FACING, side_m=0.1, family="apriltag-1h1"),
        lambda: Occluder(share=1.0),
        lambda: Blur(sigma_px=-1.0),
        lambda: Sensor(jpeg_quality=0),
        lambda: Sensor(noise=float("nan")),
        lambda: Scene(camera=LENS, target=None, seed=1, finer=0),
    ],
)
def test_what_cannot_be_drawn_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match=r"\d|nan|inf"):
        wrong()
