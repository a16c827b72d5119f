"""The table of what is found on real pictures counts right."""

from __future__ import annotations

import cv2
import numpy as np

SHEET = [(100.0, 100.0), (300.0, 110.0), (290.0, 250.0), (95.0, 240.0)]
BALL = (120.0, 90.0, 40.0)


def test_a_sheet_is_found_from_whichever_corner_it_is_told() -> None:
    from recall import is_quad

    assert is_quad(SHEET, SHEET)
    assert is_quad(SHEET, [*SHEET[2:], *SHEET[:2]])
    assert is_quad(SHEET, SHEET[::-1])
    assert is_quad(SHEET, [(x + 3, y - 2) for x, y in SHEET])


def test_a_sheet_elsewhere_of_another_size_or_with_more_corners_is_not_the_sheet() -> None:
    from recall import is_quad

    assert not is_quad(SHEET, [(x + 40, y) for x, y in SHEET])
    assert not is_quad(SHEET, [(195 + 1.1 * (x - 195), 175 + 1.1 * (y - 175)) for x, y in SHEET])
    assert not is_quad(SHEET, [*SHEET, (90.0, 170.0)])


def test_a_ball_is_found_by_part_of_its_rim_and_not_by_another_circle() -> None:
    from recall import _circle, is_circle

    assert is_circle([BALL], _circle(BALL)[:14])
    assert is_circle([(0.0, 0.0, 10.0), BALL], _circle(BALL))
    assert not is_circle([BALL], _circle((120.0, 90.0, 43.0)))
    assert not is_circle([BALL], _circle((130.0, 90.0, 40.0)))


def test_the_plain_method_and_the_tutorial_see_what_is_plain_to_see() -> None:
    import tutorial
    from recall import _circle, is_circle, is_quad, plain_ball, plain_sheet

    image = np.full((480, 640, 3), (70, 90, 110), np.uint8)
    cv2.fillPoly(image, [np.array(SHEET, np.int32)], (235, 235, 235))
    assert is_quad(SHEET, plain_sheet(image, 1.45))
    ball = np.full((480, 640, 3), (70, 90, 110), np.uint8)
    cv2.circle(ball, (300, 200), 60, (60, 220, 230), cv2.FILLED, cv2.LINE_AA)
    assert is_circle([(300.0, 200.0, 60.0)], plain_ball(ball))
    found = tutorial.ball_circle(ball, np.array((25, 80, 80)), np.array((35, 255, 255)))
    assert is_circle([(300.0, 200.0, 60.0)], _circle(found))
