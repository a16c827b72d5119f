"""The sides of outlines, on drawn pictures whose truth is exact."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.detectors.sampling import light_table
from stadimeter.detectors.sheet.edges import SheetPicture, measure_edges, settle_edges
from stadimeter.detectors.sheet.one_outline import SUPPORTED, measure_each, settle_each
from stadimeter.detectors.sheet.quadrilaterals import (
    SearchedPicture,
    find_quadrilaterals,
    not_seen_before,
    other_masks,
    pale_masks,
    quick_masks,
)
from support.scenes.draw import sheet_scene
from support.scenes.render import render

pytestmark = pytest.mark.vision

LIGHT = light_table("srgb")
MADE = render(sheet_scene(4, 0.4, plain=True))
SEEN = SheetPicture(MADE.image, LIGHT, None)
CORNERS = MADE.truth.outline_px


@pytest.mark.long
@given(st.lists(st.floats(-2.0, 2.0), min_size=8, max_size=8))
def test_the_corners_do_not_depend_on_where_the_search_starts(moves: list[float]) -> None:
    start = CORNERS + np.array(moves).reshape(4, 2)
    edges = settle_edges(SEEN, measure_edges(SEEN, start[None], 6.0))
    exact = settle_edges(SEEN, measure_edges(SEEN, CORNERS[None], 6.0))
    assert np.abs(edges.corners_px - exact.corners_px).max() < 0.02
    assert np.abs(edges.corners_px[0] - CORNERS).max() < 0.15


def test_many_outlines_at_once_give_what_each_gives_alone() -> None:
    starts = np.stack((CORNERS, CORNERS + 1.0, CORNERS * 0.9 + 20))
    together = measure_edges(SEEN, starts, 6.0)
    for number, start in enumerate(starts):
        alone = measure_edges(SEEN, start[None], 6.0)
        assert together.corners_px[number] == pytest.approx(alone.corners_px[0], nan_ok=True)
        assert together.support[number] == pytest.approx(alone.support[0])


def test_a_bright_sheet_stands_out_with_one_sign_on_all_sides_and_nothing_does_not() -> None:
    edges = measure_edges(SEEN, CORNERS[None], 6.0)
    assert (edges.contrast > 50).all()
    assert (edges.support > 0.9).all()
    away = measure_edges(SheetPicture(np.full_like(MADE.image, 90), LIGHT, None), CORNERS[None], 6.0)
    assert (away.support == 0).all()


@pytest.mark.parametrize("masks", [quick_masks, pale_masks, other_masks])
def test_the_outline_of_the_sheet_is_among_those_found(masks) -> None:
    outlines = find_quadrilaterals(masks(SearchedPicture.of(MADE.image)), 10.0)
    apart = np.abs(outlines[:, :, None] - CORNERS[None, None]).max(axis=3).min(axis=1).max(axis=1)
    assert apart.min() < 3


def test_something_that_touches_the_sheet_does_not_hide_its_outline() -> None:
    mask = np.zeros((200, 300), np.uint8)
    mask[50:150, 80:220] = 255
    mask[100:110, 220:280] = 255
    mask[20:50, 120:130] = 255
    outlines = find_quadrilaterals([mask], 10.0)
    wanted = np.array(((80, 50), (219, 50), (219, 149), (80, 149)))
    assert np.abs(outlines - wanted).max(axis=(1, 2)).min() < 2


def test_a_side_half_hidden_is_left_to_the_more_thorough_search() -> None:
    middle = CORNERS[:2].mean(axis=0)
    left, right = np.add(middle, (-17, -12)), np.add(middle, (17, -12))
    finger = np.array((left, right, CORNERS.mean(axis=0)))
    image = np.asarray(cv2.fillPoly(MADE.image.copy(), [np.rint(finger).astype(np.int32)], (20, 60, 200)))
    hidden = SheetPicture(image, LIGHT, None)
    assert measure_each(hidden, CORNERS[None], 1.0) == [None]
    settled = settle_each(hidden, measure_edges(hidden, CORNERS[None], 6.0))
    assert np.abs(settled.corners_px[0] - CORNERS).max() < 0.2
    assert settled.support.min() < SUPPORTED


def test_an_outline_counts_as_seen_before_to_a_pixel() -> None:
    seen: set[tuple[float, ...]] = set()
    corners = np.round(np.stack((CORNERS, CORNERS + 5.0)))
    assert not_seen_before(corners, seen).all()
    assert not_seen_before(np.stack((corners[1] + 0.3, corners[1] + 2.0)), seen).tolist() == [False, True]
