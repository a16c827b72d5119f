"""Dirt on a part of the lens is found, and people and lamps are not taken for it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stadimeter.perception.lens_dirt import CHECKS, HALF_HOURS, PART_PX, DirtJudge, look_at_parts
from support.watched_room import LENS, WatchedRoom

NOON = 720


@pytest.fixture(scope="module")
def pictures():
    return WatchedRoom(seed=31).pictures(NOON)


@pytest.fixture(scope="module")
def clean(pictures):
    return look_at_parts(pictures, LENS)


@pytest.fixture(scope="module")
def detail_px(clean):
    """Where the picture has most to see: the middle of a disc."""
    rows = cv2.blur(clean[0], (5, 5))[3:-3, 3:-3]
    row, column = np.unravel_index(rows.argmax(), rows.shape)
    return int(PART_PX * (column + 3.5)), int(PART_PX * (row + 3.5))


@pytest.fixture
def judge(clean):
    judge = DirtJudge()
    for _ in range(HALF_HOURS * CHECKS):
        assert judge.judge(clean) == ""
    return judge


def half_an_hour(judge, parts):
    return [judge.judge(parts) for _ in range(CHECKS)][-1]


def disc(pictures, centre_px, change):
    """Return the pictures, each changed within a disc of a tenth of their width."""
    inside = cv2.circle(np.zeros(pictures[0].shape, np.uint8), centre_px, 32, (1, 1, 1), -1)
    return [np.where(inside, change(each), each) for each in pictures]


def drop(image):
    return cv2.GaussianBlur(image, (0, 0), 5)


def test_a_drop_before_something_to_see_is_found_after_half_an_hour(judge, pictures, clean, detail_px) -> None:
    dirty = look_at_parts(disc(pictures, detail_px, drop), LENS)
    assert not any(judge.judge(dirty) for _ in range(CHECKS - 1))
    words = judge.judge(dirty)
    down = ("upper", "middle", "lower")[3 * detail_px[1] // 480]
    across = ("left", "centre", "right")[3 * detail_px[0] // 640]
    assert f"at the {down} {across} of the picture" in words
    assert all(half_an_hour(judge, dirty) for _ in range(HALF_HOURS)), "it is not learnt"
    assert half_an_hour(judge, clean) == "", "it was wiped off"


def test_a_person_who_stands_there_for_twenty_minutes_is_no_dirt(judge, pictures, clean, detail_px) -> None:
    dirty = look_at_parts(disc(pictures, detail_px, drop), LENS)
    assert not any(judge.judge(dirty) for _ in range(20))
    assert not any(judge.judge(clean) for _ in range(20))
