"""Each trouble does to the picture what it says."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from support.each_case import each_case
from support.scenes.backdrop import ClutterBackdrop, PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.blur import Blur
from support.scenes.draw import ball_scene, empty_scene
from support.scenes.nuisances import BALL_NUISANCES, HARDER_NUISANCES, dark_side, distractors
from support.scenes.occluder import Occluder
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.sensor import Sensor
from support.scenes.tone import Tone, decode_srgb, encode

pytestmark = pytest.mark.vision

LENS = CameraModel.with_focal_length(600.0, 640, 480)
FACING = Pose(position_m=(0.0, 0.0, 1.0))
WHITE = (255, 255, 255)


def even(light: float) -> np.ndarray:
    return np.full((120, 160, 3), light, np.float32)


@pytest.mark.parametrize(("tone", "code"), [(Tone.SRGB, 188), (Tone.LINEAR, 128), (Tone.GAMMA_1_8, 173)])
def test_a_pixel_half_covered_by_white_has_the_code_value_of_half_the_light(bare, sheet, tone, code) -> None:
    # The right edge goes through the middle of column 400.
    right_m = (400 - 319.5) / 600
    target = sheet(Pose(position_m=(right_m - 0.1, 0.0, 1.0)), 0.2, 0.2)
    image = render(bare(target, sensor=Sensor(noise=0.0, tone=tone))).image
    assert image[240, 398:403, 1].tolist() == [255, 255, code, 0, 0]


def test_encoding_undoes_decoding() -> None:
    codes = np.arange(256)
    assert encode(decode_srgb(codes), Tone.SRGB) == pytest.approx(codes, abs=0.05)


@pytest.mark.parametrize("tone", list(Tone))
def test_every_tone_curve_rises_from_black_to_white(tone) -> None:
    codes = encode(np.linspace(0, 1, 500, dtype=np.float32), tone)
    assert (codes[0], codes[-1]) == pytest.approx((0, 255), abs=0.01)
    assert (np.diff(codes) >= 0).all()


@pytest.mark.long
def test_the_same_scene_gives_the_same_picture_and_another_seed_another_one() -> None:
    scene = BALL_NUISANCES["all in one"](ball_scene(3))
    first = render(scene).image
    render(ball_scene(4))
    assert np.array_equal(first, render(scene).image)
    assert not np.array_equal(first, render(replace(scene, seed=5)).image)


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


def test_exposure_doubles_the_light_with_each_stop() -> None:
    rng = np.random.default_rng(0)
    for stops, code in ((-1.0, 51), (0.0, 102), (1.0, 204), (2.0, 255)):
        sensor = Sensor(noise=0.0, tone=Tone.LINEAR, exposure_ev=stops)
        assert sensor.develop(even(0.4), rng)[5, 5, 0] == code


def test_sharpening_overshoots_at_an_edge(bare, sheet) -> None:
    target = SheetTarget(pose=FACING, width_m=0.3, height_m=0.2, bgr=(200, 200, 200))
    backdrop = PlainBackdrop(bgr=(90, 90, 90), stains=0.0)
    scene = bare(target, backdrop=backdrop, blur=Blur(), sensor=Sensor(noise=0.0))
    plain = render(scene).image
    sharp = render(replace(scene, sensor=Sensor(noise=0.0, sharpening=0.8))).image
    assert (plain.min(), plain.max()) == (90, 200)
    assert sharp.min() < 87
    assert sharp.max() > 203


def test_jpeg_halves_the_resolution_of_colour_but_not_of_brightness() -> None:
    rng = np.random.default_rng(0)
    colours, greys = np.zeros((2, 64, 64, 3), np.float32)
    # Red and blue columns of about the same brightness; light and dark ones.
    colours[:, ::2], colours[:, 1::2] = (0.05, 0.05, 0.5), (0.9, 0.15, 0.05)
    greys[:, ::2], greys[:, 1::2] = 0.6, 0.1
    sensor = Sensor(noise=0.0, jpeg_quality=100)
    red_minus_blue = sensor.develop(colours, rng).astype(int) @ (-1, 0, 1)
    assert np.ptp(red_minus_blue[20:40, 20:40]) < 20
    assert np.ptp(sensor.develop(greys, rng)[20:40, 20:40]) > 90


def test_a_lower_jpeg_quality_changes_the_picture_more() -> None:
    scene = replace(ball_scene(8), sensor=Sensor(noise=0.0))
    clean = render(scene).image.astype(float)
    errors = [
        np.abs(render(replace(scene, sensor=Sensor(noise=0.0, jpeg_quality=quality))).image - clean).mean()
        for quality in (95, 80, 40)
    ]
    assert 0 < errors[0] < errors[1] < errors[2]


@pytest.mark.parametrize("share", [0.1, 0.2, 0.4])
@pytest.mark.parametrize("from_rad", [0.0, 2.1, 4.5])
def test_an_occluder_hides_its_share_of_the_target(bare, ball, cover, share, from_rad) -> None:
    scene = bare(ball((0.1, 0.05, 1.0), 0.2))
    board = Occluder(share=share, from_rad=from_rad, bgr=(0, 0, 0))
    visible = cover(replace(scene, occluder=board)).sum() / cover(scene).sum()
    assert visible == pytest.approx(1 - share, abs=0.002)


def test_what_is_hidden_is_on_the_side_that_the_occluder_comes_from(bare, ball, cover) -> None:
    scene = bare(ball((0.0, 0.0, 1.0), 0.2), occluder=Occluder(share=0.3, from_rad=math.pi / 2, bgr=(0, 0, 0)))
    rows = np.arange(480)
    drawn = cover(scene)
    assert float((drawn.sum(axis=1) * rows).sum() / drawn.sum()) < 239.5 - 10


def test_a_glossy_ball_has_a_white_spot_where_the_lamp_is_mirrored() -> None:
    towards_camera = (0.0, 0.0, -1.0)
    ball = BallTarget(position_m=(0.0, 0.0, 0.6), diameter_m=0.2, light=towards_camera, specular=0.9)
    scene = Scene(camera=LENS, target=ball, seed=1, backdrop=PlainBackdrop(), sensor=Sensor(noise=0.0))
    glossy, matte = render(scene).image, render(replace(scene, target=replace(ball, specular=0.0))).image
    assert glossy[239:241, 319:321].min() > 225
    assert np.argwhere(glossy[:, :, 0] > 225).mean(axis=0) == pytest.approx((239.5, 319.5), abs=1)
    assert matte[240, 320, 0] < 80


def test_the_dark_side_gets_only_the_ambient_light() -> None:
    ball = BallTarget(position_m=(0.0, 0.0, 0.6), diameter_m=0.2, bgr=WHITE, light=(-1.0, 0.0, 0.0))
    scene = Scene(camera=LENS, target=ball, seed=1, blur=Blur(sigma_px=0.0), sensor=Sensor(noise=0.0, tone=Tone.LINEAR))
    image = render(dark_side(scene)).image
    assert image[240, 360, 1] == pytest.approx(255 * 0.12, abs=1)
    assert image[240, 225, 1] > 200


@pytest.mark.parametrize("seed", range(4))
def test_distractors_have_the_targets_colour_and_keep_away_from_it(seed) -> None:
    def of_the_colour(scene: Scene) -> np.ndarray:
        hsv = cv2.cvtColor(render(scene).image, cv2.COLOR_BGR2HSV)
        return cv2.inRange(hsv, (34, 180, 150), (40, 210, 255)) > 0

    scene = ball_scene(seed)
    more = of_the_colour(distractors(12)(scene)) & ~of_the_colour(scene)
    assert more.sum() > 200
    outline = render(scene).truth.outline_px
    rows, columns = np.indices(more.shape)
    off = np.hypot(columns - outline[:, 0].mean(), rows - outline[:, 1].mean())
    assert off[more].min() > 1.2 * np.ptp(outline[:, 0]) / 2


@pytest.mark.long
@each_case("name", list(BALL_NUISANCES) + list(HARDER_NUISANCES))
def test_every_trouble_of_a_ball_changes_the_picture_but_not_the_truth(name) -> None:
    scene = ball_scene(11)
    before, after = render(scene), render((BALL_NUISANCES | HARDER_NUISANCES)[name](scene))
    assert after.truth.position_m == before.truth.position_m
    assert np.array_equal(before.image, after.image) == (name == "clean")


def test_clutter_is_busy_and_differs_from_seed_to_seed() -> None:
    first, second = (render(empty_scene(seed)).image for seed in (1, 2))
    assert cv2.countNonZero(cv2.Canny(first, 35, 125)) > 5000
    assert np.abs(first.astype(int) - second).mean() > 20


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
