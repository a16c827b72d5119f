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
from support.scenes.backdrop import SHEETLIKE_ASPECTS, PlainBackdrop
from support.scenes.cut_sheet import Curl, CutSheetTarget, GroupTarget, HandCut
from support.scenes.draw import CAMERA, MARGIN_PX
from support.scenes.plane import Pose
from support.scenes.render import render
from support.scenes.room import RoomBackdrop, paperlike
from support.scenes.scene import Scene
from support.scenes.shadow import ShadedBackdrop, Shadow

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


def test_a_cut_side_is_a_smooth_curve_and_no_fringe() -> None:
    steps = [np.abs(np.diff(HandCut(ends_m=0.001, sides_m=0.001, seed=s).deviation_m(0, ALONG))) for s in range(30)]
    # A hundredth of the side, half a millimetre, changes by a fraction of a millimetre at most.
    assert np.max(steps) < 0.0004


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


def test_an_uncut_sheet_measures_what_was_meant_and_a_cut_one_does_not(bare, cover) -> None:
    meant = outline_area_px(card().outline_m())
    assert cover(bare(card())).sum() == pytest.approx(meant, rel=0.002)
    areas = [outline_area_px(card(cut=HandCut(ends_m=0.002, sides_m=0.002, seed=s)).cut_outline_m()) for s in range(20)]
    assert np.std(areas) > 0.01 * meant


def test_a_curled_corner_takes_paper_away_there_and_nowhere_else(bare, cover) -> None:
    facing = Pose(position_m=(0.0, 0.0, 0.5))
    flat = cover(bare(card(pose=facing)))
    curled = cover(bare(card(pose=facing, curls=(Curl(corner=(1, -1), length_m=0.02, angle_rad=1.2),))))
    lost_y, lost_x = np.nonzero(flat - curled > 0.02)
    corner = np.array((319.5 + 60, 239.5 - 45))
    assert 20 < len(lost_x) < 400
    # The bent part reaches 2 cm in from the corner: 24 px along the diagonal, 34 along the sides.
    assert np.hypot(lost_x - corner[0], lost_y - corner[1]).max() < 36


def test_a_sheet_cannot_curl_right_over() -> None:
    with pytest.raises(ValueError, match="curl"):
        Curl(corner=(1, 1), length_m=0.02, angle_rad=1.6)


def test_a_shadow_darkens_the_sheet_and_what_is_behind_it_alike(bare) -> None:
    facing = Pose(position_m=(0.0, 0.0, 0.5))
    shadow = Shadow(through=(0.0, 0.0), from_rad=0.0, softness=0.01, depth=0.5)
    grey = PlainBackdrop(bgr=(188, 188, 188), stains=0.0)
    behind = ShadedBackdrop(inner=grey, shadow=shadow, camera=CAMERA)
    image = render(bare(card(pose=facing, shadow=shadow), backdrop=behind)).image.astype(float)
    row, above = image[240, :, 1], image[50, :, 1]
    assert row[340] / row[300] == pytest.approx(0.5, abs=0.02)
    assert above[340] / above[300] == pytest.approx(0.5, abs=0.02)


def test_what_is_written_on_a_sheet_leaves_its_sides_white(bare) -> None:
    facing = Pose(position_m=(0.0, 0.0, 0.5))
    image = render(bare(card(pose=facing, print_share=1.0, seed=3))).image[:, :, 1]
    assert image[205:275, 270:370].min() < 120
    assert image[240, 261:263].min() > 240


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


def test_tape_has_straight_sides_and_cut_ends() -> None:
    flat = hard_flats.hard_tape(3, 0.002, pairs=0.0)
    cut = flat.scene.target.cut
    assert np.abs(cut.deviation_m(1, ALONG)).max() < np.abs(cut.deviation_m(0, ALONG)).max()
    assert (cut.ends_m, cut.sides_m) == (0.002, hard_flats.STRAIGHT_M)


def test_an_unknown_lens_bends_the_picture_and_changes_nothing_else() -> None:
    flat = hard_flats.hard_sheet(5, 0.0, (40.0, 60.0))
    bent = hard_flats.unknown_lens(flat.scene)
    assert 0 < abs(bent.camera.distortion[0]) <= hard_flats.UNKNOWN_LENS_K1
    assert replace(bent, camera=flat.scene.camera) == flat.scene


def test_the_same_room_comes_again_and_another_seed_makes_another() -> None:
    first, again, other = (RoomBackdrop().light(160, 120, seed, None) for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).mean() > 0.5


def test_rooms_have_edges_texture_and_no_glow() -> None:
    for seed in range(4):
        light = RoomBackdrop().light(320, 240, seed, None)
        assert light.shape == (240, 320, 3)
        assert light.min() >= 0
        assert light.max() < 4
        assert cv2.Laplacian(light[:, :, 1], cv2.CV_32F).std() > 0.005


@given(width=st.floats(0.05, 2), height=st.floats(0.05, 2))
def test_paper_is_told_by_its_aspect_either_way_round(width, height) -> None:
    aspect = max(width, height) / min(width, height)
    assert (
        paperlike(width, height) == paperlike(height, width) == (SHEETLIKE_ASPECTS[0] < aspect < SHEETLIKE_ASPECTS[1])
    )


def test_round_things_are_only_there_if_they_are_asked_for() -> None:
    plain, round_ones = (RoomBackdrop(round_things=count).light(320, 240, 3, None) for count in (0, 4))
    assert (plain != round_ones).any()
    assert isinstance(hard_flats.hard_empty(0), Scene)
    assert hard_flats.hard_empty(0).target is None
