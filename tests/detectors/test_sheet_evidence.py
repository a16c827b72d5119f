"""What speaks for an outline being the sheet: tolerances, looks, other outlines, and what says too little."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from support.each_case import each_case
from support.scenes.draw import CAMERA, empty_scene, sheet_scene
from support.scenes.hard_flats import TEXTURE, hard_tape
from support.scenes.render import render

pytestmark = pytest.mark.vision

CARD = {"width": "100 mm", "height": "75 mm"}
CARD_M = np.array((0.100, 0.075))
SQUARE = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
WHITE, GREEN = (228, 232, 230), (60, 170, 70)
WHITES = "0,0,150:179,60,255"


def card(centre_px: tuple[float, float], length_px: float, cut_mm: np.ndarray | float = 0.0) -> np.ndarray:
    """Return the corners of a card that faces the camera, each moved by so many millimetres."""
    return (SQUARE * CARD_M / 2 + np.asarray(cut_mm) / 1000) * length_px / CARD_M[0] + centre_px


def found(image: np.ndarray, camera=CAMERA, **options: object) -> Detection:
    detector = SheetDetector("card", SheetOptions.model_validate({**CARD, "min_side_px": 8, **options}))
    return detector.detect(Frame(image, 0.0, 0), lens=camera)


CUT_MM = np.array([(0.9, -0.8), (-0.7, 0.9), (0.8, 0.6), (-0.9, -0.7)])


@pytest.mark.parametrize("length_px", [20, 30, 45, 60])
def test_a_card_that_was_cut_by_hand_is_found(draw, wall, length_px: float) -> None:
    corners = card((330.3, 210.7), length_px, CUT_MM)
    seen = found(draw.noise(draw.polygon(wall(), corners, WHITE)))
    assert seen.status is DetectionStatus.FOUND, seen.reason
    assert np.abs(seen.outline_px - corners).max() < 0.5


def test_the_tolerance_reaches_the_test_of_the_shape(draw, wall) -> None:
    higher = card((330.3, 210.7), 120) * (1, 1.1) - (0, 21)
    image = draw.noise(draw.polygon(wall(), higher, WHITE))
    refused, taken = found(image), found(image, tolerance="5 mm")
    assert refused.status is DetectionStatus.NOT_FOUND
    assert re.search(r"from those of the sheet|too little speaks for it: evidence -?\d+\.\d, limit", refused.reason)
    assert taken.status is DetectionStatus.FOUND


@pytest.mark.long
@each_case("seed", range(6))
def test_clutter_is_neither_a_sheet_of_one_known_side_nor_one_that_is_cut_off(seed: int) -> None:
    image = render(empty_scene(seed + 40)).image
    for options in ({"known_side": "width"}, {}):
        assert found(image, **options).status is DetectionStatus.NOT_FOUND


def test_one_side_is_enough_before_a_wall(draw, wall) -> None:
    seen = found(draw.noise(draw.polygon(wall(), card((330, 210), 60), WHITE)), height="10 cm", known_side="width")
    assert seen.width_px == pytest.approx(60, abs=0.3)


def test_a_side_alone_does_not_make_a_sheet_of_what_is_turned_away(draw, wall) -> None:
    leaning = card((330, 210), 60) + np.array([(18, 0), (18, 0), (0, 0), (0, 0)])
    seen = found(draw.noise(draw.polygon(wall(), leaning, WHITE)), known_side="width")
    assert seen.status is DetectionStatus.NOT_FOUND
    assert re.search(r"from those of the sheet|too little speaks for it", seen.reason)


def two_cards(draw, wall, second: tuple[int, int, int]) -> np.ndarray:
    """Return a picture of two cards that are cut so badly that neither is the sheet beyond doubt."""
    picture = draw.polygon(wall(), card((180.3, 150.2), 22, 2 * CUT_MM), WHITE)
    return draw.noise(draw.polygon(picture, card((430.6, 300.4), 33, -2 * CUT_MM), second))


def test_where_two_outlines_may_be_the_sheet_none_is_measured_and_both_are_named(draw, wall) -> None:
    seen = found(two_cards(draw, wall, WHITE), tolerance="6 mm")
    assert seen.status is DetectionStatus.NOT_FOUND
    assert re.match(r"ambiguous: two outlines fit, one 3\d px long at \(431, 300\), one 2\d px long at", seen.reason)
    assert len(seen.rejected) >= 2


def test_its_colour_tells_which_of_two_outlines_is_the_sheet(draw, wall) -> None:
    seen = found(two_cards(draw, wall, GREEN), tolerance="6 mm", hsv=WHITES)
    assert seen.status is DetectionStatus.FOUND, seen.reason
    assert seen.centre_px == pytest.approx((180.3, 150.2), abs=1)


def test_two_sheets_beyond_doubt_at_different_distances_contradict_each_other(draw, wall) -> None:
    picture = draw.polygon(wall(), card((180, 150), 120), WHITE)
    seen = found(draw.polygon(picture, card((430, 300), 80), WHITE))
    assert seen.status is DetectionStatus.NOT_FOUND
    assert re.match(r"ambiguous: two outlines fit, one 120 px long at \(180, 150\), one 80 px long at", seen.reason)


def test_what_is_on_a_sheet_is_no_rival_of_it(draw, wall) -> None:
    picture = draw.polygon(wall(), card((320, 240), 240), WHITE)
    seen = found(draw.noise(draw.polygon(picture, card((320, 240), 120), GREEN)))
    assert seen.status is DetectionStatus.FOUND, seen.reason
    assert seen.width_px == pytest.approx(240, abs=0.5)


def test_paper_is_brighter_than_a_dark_frame_of_its_aspect(draw, wall) -> None:
    picture = draw.polygon(wall(), card((180, 150), 160), (28, 26, 24))
    seen = found(draw.noise(draw.polygon(picture, card((430, 300), 80), WHITE)))
    assert seen.status is DetectionStatus.FOUND, seen.reason
    assert seen.centre_px == pytest.approx((430, 300), abs=0.5)


def test_what_looks_like_a_frame_or_a_screen_is_only_perhaps_the_sheet(draw, wall) -> None:
    dark = draw.noise(draw.polygon(wall(), card((320, 240), 160), (28, 26, 24)))
    assert found(dark).status is DetectionStatus.PERHAPS
    assert "darker than what is around it; name its colour" in found(dark).reason
    assert found(dark, hsv="0,0,0:179,255,60").status is DetectionStatus.FOUND
    framed = draw.polygon(draw.polygon(wall(), card((320, 240), 160), (28, 26, 24)), card((320, 240), 130), WHITE)
    seen = found(draw.noise(framed))
    assert seen.status is DetectionStatus.PERHAPS
    assert seen.reason == "it is in a frame; name its colour if it is the sheet"


STRIP_M = np.array((2, 5.5)) * 0.0254
LIT = (130, 245, 150)


def two_strips(draw, depths_m: tuple[float, float], lean_deg: float = 0.0) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return a picture of strips of tape before the dark, 8 inches of dark between them, and their corners."""
    picture, outlines = np.full((480, 640, 3), (24, 20, 22), np.uint8), []
    for side, depth_m in zip((-1, 1), depths_m, strict=True):
        lean = math.radians(side * lean_deg)
        turn = np.array(((math.cos(lean), -math.sin(lean)), (math.sin(lean), math.cos(lean))))
        place_m = (SQUARE * STRIP_M / 2) @ turn.T + (side * 5 * 0.0254, 0)
        outlines.append(place_m * CAMERA.fx_px / depth_m + (318.3, 240.6))
        picture = draw.polygon(picture, outlines[-1], LIT)
    return draw.noise(picture), outlines


@pytest.mark.parametrize(("feet", "lean_deg", "least"), [(2, 14.5, {}), (5, 0.0, {}), (9, 14.5, {"min_side_px": 8})])
def test_of_two_strips_of_tape_beside_each_other_one_is_measured(draw, feet: int, lean_deg: float, least) -> None:
    image, outlines = two_strips(draw, (feet * 0.3048, feet * 0.3048), lean_deg)
    detector = SheetDetector("tape", SheetOptions.model_validate({"width": "2 in", "height": "5.5 in", **least}))
    seen = detector.detect(Frame(image, 0.0, 0), lens=CAMERA)
    assert seen.status is DetectionStatus.FOUND, seen.reason
    assert min(np.abs(seen.outline_px.mean(axis=0) - each.mean(axis=0)).max() for each in outlines) < 0.5
    assert "several fit alike" in seen.reason


@pytest.mark.long
@each_case("seed", [1, 3, 8, 12, 13, 18])
def test_tape_on_a_carpet_is_found_by_how_it_stands_out(seed: int) -> None:
    flat = hard_tape(seed, sizes_px=(36.0, 60.0), backdrop=TEXTURE, pairs=0.0)
    made = render(flat.scene)
    seen = found(made.image, width=f"{flat.width_m} m", height=f"{flat.height_m} m", tolerance="0.7 mm")
    assert seen.status is DetectionStatus.FOUND, seen.reason
    assert np.abs(seen.outline_px.mean(axis=0) - made.truth.outline_px.mean(axis=0)).max() < 2


def test_a_white_card_before_a_pale_wall_is_found_though_the_wall_has_its_colour(draw) -> None:
    wall = np.full((480, 640, 3), (168, 172, 175), np.uint8)
    seen = found(draw.noise(draw.polygon(wall, card((330.3, 210.7), 40, CUT_MM), WHITE)), hsv=WHITES)
    assert seen.status is DetectionStatus.FOUND, seen.reason


@pytest.mark.parametrize("bias_px", [3.6, 100.0, -7.0])
@pytest.mark.parametrize("known_side", ["auto", "width"])
def test_an_edge_bias_as_large_as_the_sheet_leaves_nothing_to_measure(draw, wall, bias_px, known_side) -> None:
    image = draw.noise(draw.polygon(wall(), card((330, 210), 14 / 0.75), WHITE))
    seen = found(image, replace(CAMERA, edge_bias_px=bias_px), known_side=known_side)
    assert seen.status is DetectionStatus.NOT_FOUND
    assert "edge bias" in seen.reason


@pytest.mark.parametrize("seed", [9, 17])
def test_a_sheet_of_another_size_than_stated_is_perhaps_it_or_among_the_rejected(seed: int) -> None:
    made = render(sheet_scene(seed, 0.3))
    centre = made.truth.outline_px.mean(axis=0)
    seen = found(made.image, width="297 mm", height="245 mm")
    assert seen.status is not DetectionStatus.FOUND
    perhaps = [seen.centre_px] if seen.status is DetectionStatus.PERHAPS else []
    shown = [*perhaps, *(each.centre_px for each in seen.rejected)]
    assert any(np.abs(np.array(each) - centre).max() < 6 for each in shown)
