"""Hard balls are drawn as they say: where they are, what is on them, and what cameras do to them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.detectors.hsv import parse_hsv_range
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.ball_surface import BallSurface, Marking
from support.scenes.blur import Blur
from support.scenes.draw import CAMERA
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


@pytest.mark.parametrize("marking", [each for each in Marking if each is not Marking.NONE])
def test_every_marking_shows_its_own_colour_beside_the_ball_s(marking):
    shown = set()
    for seed in range(6):  # some logos are on the far side
        image = render(scene_of(BallSurface(bgr=GREEN, marking=marking, marking_bgr=(255, 255, 255), seed=seed))).image
        inside = image[205:295, 270:395].reshape(-1, 3).astype(int)
        shown |= {"pale"} if (inside.min(axis=1) > 200).any() else set()
        shown |= {"green"} if (np.abs(inside - GREEN).max(axis=1) < 25).any() else set()
    assert shown == {"pale", "green"}


def test_fingers_cover_a_part_of_the_ball_and_leave_the_rest():
    surface = BallSurface(bgr=(255, 255, 255))
    free = render(scene_of(surface)).image[:, :, 0] > 240
    held = render(scene_of(surface, occluder=Hand(depth=0.4, bgr=(60, 80, 120)))).image[:, :, 0] > 240
    assert 0.5 * free.sum() < held.sum() < 0.95 * free.sum()
    assert not (held & ~free).any()


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
