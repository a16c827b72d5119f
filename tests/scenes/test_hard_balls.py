"""Hard balls are drawn as they say: where they are, what is on them, and what cameras do to them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.detectors.hsv import parse_hsv_range
from support.scenes.backdrop import KeepOut, PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.ball_surface import BallSurface, Marking
from support.scenes.blur import Blur
from support.scenes.draw import CAMERA
from support.scenes.floor import FloorBackdrop, Ground
from support.scenes.hand import Hand
from support.scenes.hard_balls import BALLS, hard_ball, picked_range
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.sensor import Sensor

pytestmark = pytest.mark.vision

GREEN = BALLS["green"]
HALF = 188
"""The code value of half the light of white."""

DARK = PlainBackdrop(bgr=(20, 20, 20))


def scene_of(surface: BallSurface, **changes: object) -> Scene:
    ball = BallTarget(position_m=(0.02, 0.01, 0.5), diameter_m=0.067, bgr=surface.bgr, ambient=1.0, surface=surface)
    clean = Sensor(noise=0.0)
    scene = Scene(camera=CAMERA, target=ball, seed=1, backdrop=DARK, blur=Blur(sigma_px=0.0), sensor=clean)
    return replace(scene, **changes)


@pytest.mark.parametrize("felt", [0.0, 0.01])
def test_a_ball_covers_the_area_of_its_outline_whether_smooth_or_felt(felt):
    made = render(scene_of(BallSurface(bgr=(255, 255, 255), felt=felt, seed=3), sensor=Sensor(noise=0.0)))
    covered = (made.image[:, :, 1] > HALF).sum()
    assert covered == pytest.approx(cv2.contourArea(made.truth.outline_px.astype(np.float32)), rel=0.015)


def test_felt_makes_the_limb_ragged_and_a_smooth_limb_is_not():
    def scatter(felt: float) -> float:
        made = render(scene_of(BallSurface(bgr=(255, 255, 255), felt=felt, seed=3)))
        mask = (made.image[:, :, 1] > HALF).astype(np.uint8)
        (contour, *_), _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        middle = made.truth.outline_px.mean(axis=0)
        return float(np.linalg.norm(contour[:, 0] - middle, axis=1).std())

    assert scatter(0.03) > 1.5 * scatter(0.0)


@pytest.mark.parametrize("marking", [each for each in Marking if each is not Marking.NONE])
def test_every_marking_shows_its_own_colour_beside_the_ball_s(marking):
    shown = set()
    for seed in range(6):  # some logos are on the far side
        image = render(scene_of(BallSurface(bgr=GREEN, marking=marking, marking_bgr=(255, 255, 255), seed=seed))).image
        inside = image[205:295, 270:395].reshape(-1, 3).astype(int)
        shown |= {"pale"} if (inside.min(axis=1) > 200).any() else set()
        shown |= {"green"} if (np.abs(inside - GREEN).max(axis=1) < 25).any() else set()
    assert shown == {"pale", "green"}


def test_the_shadow_of_a_ball_on_the_floor_is_darkest_just_below_it():
    floor = FloorBackdrop(ground=Ground.MAT, bgr=(150, 150, 150), contrast=0.0, shadow=0.8)
    light = floor.light(640, 480, 1, KeepOut(centre_px=(320, 200), radius_px=40))
    bare = floor.light(640, 480, 1, None)
    left = light.mean(axis=2) / bare.mean(axis=2)
    assert left[200 + 36, 320] < 0.4
    assert left[60, 320] == pytest.approx(1.0)


@pytest.mark.parametrize("ground", list(Ground))
def test_each_floor_varies_by_its_contrast(ground):
    def spread(contrast: float) -> float:
        floor = FloorBackdrop(ground=ground, bgr=(120, 120, 120), contrast=contrast, shadow=0.0)
        light = floor.light(320, 240, 1, None)[80:160, 100:220]
        return float(light.std() / light.mean())

    assert spread(0.4) > spread(0.1) + 0.05


def test_fingers_cover_a_part_of_the_ball_and_leave_the_rest():
    surface = BallSurface(bgr=(255, 255, 255))
    free = render(scene_of(surface)).image[:, :, 0] > 240
    held = render(scene_of(surface, occluder=Hand(depth=0.4, bgr=(60, 80, 120)))).image[:, :, 0] > 240
    assert 0.5 * free.sum() < held.sum() < 0.95 * free.sum()
    assert not (held & ~free).any()


def test_shot_noise_grows_with_the_light():
    def noise(grey: int) -> float:
        sensor = Sensor(noise=0.0, shot_noise=0.03)
        light = np.full((100, 100, 3), (grey / 255) ** 2.2, np.float32)
        image = sensor.develop(light, np.random.default_rng(1))
        # Back to light, where photons arrive.
        return float(((image / 255.0) ** 2.2).std())

    assert noise(200) > 1.5 * noise(100)


def test_halved_colour_keeps_the_brightness_and_blurs_the_colour():
    light = np.zeros((64, 64, 3), np.float32)
    light[:, 33:] = (0.1, 0.1, 0.9)
    light[:, :33] = (0.1, 0.27, 0.1)
    sharp = Sensor(noise=0.0).develop(light, np.random.default_rng(1))
    halved = Sensor(noise=0.0, halved_colour=True).develop(light, np.random.default_rng(1))
    luma = [cv2.cvtColor(each, cv2.COLOR_BGR2YCrCb)[32, :, 0].astype(int) for each in (sharp, halved)]
    red = [each[32, :, 2].astype(int) for each in (sharp, halved)]
    assert np.abs(luma[0] - luma[1]).max() <= 40
    assert (np.diff(red[0]) != 0).sum() < (np.diff(red[1]) != 0).sum()


def test_the_range_that_a_user_picks_holds_most_of_the_ball_and_none_of_its_markings():
    for colour in BALLS.values():
        picked = parse_hsv_range(picked_range(colour))
        assert picked.mask(np.full((4, 4, 3), colour, np.uint8)).all()
        assert not picked.mask(np.full((4, 4, 3), (225, 230, 228), np.uint8)).any()


def test_a_hard_ball_is_the_same_each_time_and_as_large_as_asked():
    one, again = hard_ball(7, (20.0, 30.0)), hard_ball(7, (20.0, 30.0))
    assert one == again
    assert (render(one.scene).image == render(again.scene).image).all()
    assert 20.0 <= one.radius_px <= 30.5
