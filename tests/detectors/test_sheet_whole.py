"""Outlines of the shape of the sheet that are not one whole thing: tiles, books in a row, frames, and cushions."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import pytest

from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from stadimeter.detectors.sheet.evidence import ends_evidence, filling_evidence, steps_across
from support.scenes.draw import CAMERA

pytestmark = pytest.mark.vision

CENTRE = np.array((330.3, 210.7))
HALF = np.array((40.0, 30.0))
SQUARE = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
WHITE, BROWN, DARK, WALL = (228, 232, 230), (70, 100, 150), (40, 45, 50), (70, 100, 120)
CARD = {"width": "100 mm", "height": "75 mm"}


def rectangle(centre=CENTRE, half=HALF) -> np.ndarray:
    return SQUARE * half + centre


def rounded(share: float) -> np.ndarray:
    """Return an outline like that of the card, whose corners are quarters of ellipses."""
    turn = np.linspace(0, np.pi / 2, 12)
    arcs = [
        SQUARE[n] * (1 - share) + share * np.column_stack((np.cos(turn + start), np.sin(turn + start)))
        for n, start in enumerate((np.pi, 1.5 * np.pi, 0, np.pi / 2))
    ]
    return np.concatenate(arcs) * HALF + CENTRE


def found(image: np.ndarray) -> Detection:
    return SheetDetector("card", SheetOptions.model_validate(CARD)).detect(Frame(image, 0.0, 0), lens=CAMERA)


def speaks_for(image: np.ndarray) -> float:
    """Return how much speaks for the card where it would be, since it looks like one whole thing."""
    corners = rectangle()[None]
    vector = np.roll(corners, -1, axis=1) - corners
    steps = steps_across(image, (corners + vector / 2)[:, :, None], vector).mean(axis=2)
    inside = np.full((1, 4, 3), WHITE, np.float64)
    return float((ends_evidence(image, corners, steps) + filling_evidence(image, corners, inside, steps))[0])


def test_a_card_alone_is_found_and_whole(draw, wall) -> None:
    image = draw.noise(draw.polygon(wall(), rectangle(), WHITE))
    assert found(image).status is DetectionStatus.FOUND
    assert speaks_for(image) > 1


@pytest.mark.parametrize("gap_px", [4, 8])
@pytest.mark.parametrize("others", [BROWN, WHITE])
def test_the_sides_of_a_tile_lead_on_as_those_of_its_neighbours(draw, wall, gap_px: int, others) -> None:
    image = wall(bgr=DARK)
    for across, down in product((-1, 0, 1), repeat=2):
        centre = CENTRE + np.array((across, down)) * (2 * HALF + gap_px)
        image = draw.polygon(image, rectangle(centre), others if across or down else WHITE)
    assert speaks_for(draw.noise(image)) < -5


def test_the_ends_of_a_book_lead_on_in_its_row(draw, wall) -> None:
    image = wall(bgr=DARK)
    for number, bgr in enumerate((BROWN, (60, 40, 150), WHITE, (150, 60, 40), BROWN)):
        image = draw.polygon(image, rectangle(CENTRE + np.array(((number - 2) * 2 * HALF[0], 0))), bgr)
    assert speaks_for(draw.noise(image)) < -1


def test_a_frame_is_hollow(draw, wall) -> None:
    frame = draw.polygon(draw.polygon(wall(), rectangle(), WHITE), rectangle(half=HALF - 5), WALL)
    assert speaks_for(draw.noise(frame)) < -5


def test_a_cushion_is_not_there_at_its_corners(draw, wall) -> None:
    assert speaks_for(draw.noise(draw.polygon(wall(), rounded(0.5), WHITE))) < -2


def test_a_sheet_may_be_curled_at_one_corner(draw, wall) -> None:
    image = draw.polygon(wall(), rectangle(), WHITE)
    image = draw.polygon(image, rectangle()[1] + np.array([(1, -1), (-9, -1), (1, 9)]), WALL)
    assert speaks_for(draw.noise(image)) > 0
    assert found(draw.noise(image)).status is DetectionStatus.FOUND


def test_writing_and_a_shadow_across_make_no_hole_in_a_sheet(draw, wall) -> None:
    image = draw.polygon(wall(), rectangle(), WHITE)
    for line_px in range(-18, 20, 9):
        x, y = np.rint(CENTRE).astype(int).tolist()
        cv2.line(image, (x - 24, y + line_px), (x + 24, y + line_px), (40, 30, 30), 2)
    shade = np.linspace(1.0, 0.75, image.shape[1])[None, :, None]
    image = draw.noise((image * shade).astype(np.uint8))
    assert speaks_for(image) > 0
    assert found(image).status is DetectionStatus.FOUND
