"""Hard flat things are drawn as they say: how they are cut, curled and shaded, and what rooms are free of."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from support.each_case import each_case
from support.scenes import hard_flats
from support.scenes.cut_sheet import CutSheetTarget, GroupTarget, HandCut
from support.scenes.draw import CAMERA, MARGIN_PX
from support.scenes.plane import Pose
from support.scenes.render import render

pytestmark = pytest.mark.vision

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
