"""Hard balls and flat things are drawn as they say."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.detectors.hsv import parse_hsv_range
from support.each_case import each_case
from support.scenes import hard_flats
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.ball_surface import BallSurface, Marking
from support.scenes.blur import Blur
from support.scenes.cut_sheet import CutSheetTarget, GroupTarget, HandCut
from support.scenes.draw import CAMERA, MARGIN_PX
from support.scenes.hand import Hand
from support.scenes.hard_balls import BALLS, picked_range
from support.scenes.plane import Pose
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.sensor import Sensor

pytestmark = pytest.mark.vision


# Hard balls are drawn as they say: where they are, what is on them, and what cameras do to them.

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


# Hard flat things are drawn as they say: how they are cut, curled and shaded, and what rooms are free of.

ALONG = np.linspace(-1, 1, 129)
POSE = Pose(position_m=(0.02, -0.03, 0.5), tilt_rad=0.5, tilt_towards_rad=0.7, roll_rad=0.2)
WHITE = (255, 255, 255)


def card(**changes) -> CutSheetTarget:
    return CutSheetTarget(**{"pose": POSE, "width_m": 0.1, "height_m": 0.075, "bgr": WHITE} | changes)


def outline_area_px(points_m) -> float:
    return cv2.contourArea(CAMERA.project(points_m[:, :2] / points_m[:, 2:]).astype(np.float32))


@given(seed=st.integers(0, 10**6), most_mm=st.floats(0.1, 3.0), side=st.integers(0, 3))
@settings(max_examples=40)
def test_no_place_of_a_cut_side_is_off_by_more_than_the_most(seed, most_mm, side) -> None:
    cut = HandCut(ends_m=most_mm / 1000, sides_m=most_mm / 1000, seed=seed)
    assert np.abs(cut.deviation_m(side, ALONG)).max() <= most_mm / 1000


def test_cut_sides_are_off_by_the_most_over_the_square_root_of_three_in_all() -> None:
    cuts = [HandCut(ends_m=0.001, sides_m=0.002, seed=seed) for seed in range(300)]
    for side, most in ((0, 0.001), (1, 0.002)):
        off = np.array([cut.deviation_m(side, ALONG) for cut in cuts])
        assert math.sqrt((off**2).mean()) == pytest.approx(most / math.sqrt(3), rel=0.05)
        assert abs(off.mean()) < 0.1 * most


@pytest.mark.parametrize("cut_m", [0.0, 0.002])
def test_a_cut_sheet_covers_the_area_of_its_true_sides(bare, cover, cut_m) -> None:
    target = card(cut=HandCut(ends_m=cut_m, sides_m=cut_m, seed=4))
    assert cover(bare(target)).sum() == pytest.approx(outline_area_px(target.cut_outline_m()), rel=0.002)


def test_the_sides_of_a_cut_sheet_are_where_its_outline_has_them(bare, cover, edge_errors) -> None:
    target = card(cut=HandCut(ends_m=0.002, sides_m=0.002, seed=9))
    points_m = target.cut_outline_m()
    places = CAMERA.project(points_m[:, :2] / points_m[:, 2:])
    tangents = np.roll(places, -3, 0) - np.roll(places, 3, 0)
    outwards = np.column_stack((tangents[:, 1], -tangents[:, 0])) / np.linalg.norm(tangents, axis=1)[:, None]
    outwards *= np.sign((outwards * (places - places.mean(axis=0))).sum(axis=1))[:, None]
    # Away from the corners, where the walk leaves over the other side.
    middle = np.tile((np.abs(ALONG) < 0.8), 4)
    errors = edge_errors(cover(bare(target)), places[middle], outwards[middle])
    assert np.abs(errors).max() < 0.1


def test_of_two_strips_both_are_drawn_and_the_first_is_the_truth(bare, cover) -> None:
    first = card(pose=Pose(position_m=(-0.08, 0.0, 0.5)))
    pair = GroupTarget(first=first, others=(card(pose=Pose(position_m=(0.08, 0.0, 0.5))),))
    seen = cover(bare(pair))
    assert seen.sum() == pytest.approx(2 * cover(bare(first)).sum(), rel=0.01)
    assert render(bare(pair)).truth.outline_px == pytest.approx(render(bare(first)).truth.outline_px)


@pytest.mark.parametrize("make", [hard_flats.hard_sheet, hard_flats.hard_tape, hard_flats.hard_disc])
def test_a_drawn_target_is_whole_and_not_smaller_than_asked_for(make) -> None:
    for seed in range(12):
        scene = make(seed).scene
        corners = scene.target.outline_m()
        places = CAMERA.project(corners[:, :2] / corners[:, 2:])
        assert (places >= MARGIN_PX - 1).all()
        assert (places <= np.array((640, 480)) - MARGIN_PX + 1).all()
        if len(places) == 4:
            assert np.linalg.norm(np.roll(places, -1, 0) - places, axis=1).min() >= hard_flats.LEAST_SIDE_PX


@each_case("bgr", hard_flats.SHEET_BGRS + hard_flats.TAPE_BGRS)
def test_the_range_that_a_user_picks_holds_the_colour_of_the_target(bgr) -> None:
    flat = replace(hard_flats.hard_sheet(1), bgr=bgr)
    low, high = (np.array(part.split(","), int) for part in flat.hsv.split(":"))
    colour = cv2.cvtColor(np.array([[bgr]], np.uint8), cv2.COLOR_BGR2HSV)[0, 0]
    assert (low <= colour).all()
    assert (colour <= high).all()
