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


def speck(image):
    return image // 4


@pytest.mark.parametrize("change", [drop, speck])
def test_a_drop_and_a_speck_before_something_to_see_are_found_after_half_an_hour(
    judge, pictures, clean, detail_px, change
) -> None:
    dirty = look_at_parts(disc(pictures, detail_px, change), LENS)
    assert not any(judge.judge(dirty) for _ in range(CHECKS - 1))
    words = judge.judge(dirty)
    down = ("upper", "middle", "lower")[3 * detail_px[1] // 480]
    across = ("left", "centre", "right")[3 * detail_px[0] // 640]
    assert f"at the {down} {across} of the picture" in words
    assert all(half_an_hour(judge, dirty) for _ in range(HALF_HOURS)), "it is not learnt"
    assert half_an_hour(judge, clean) == "", "it was wiped off"


def test_what_is_on_the_lens_from_the_start_is_taken_for_the_view(pictures, detail_px) -> None:
    judge, dirty = DirtJudge(), look_at_parts(disc(pictures, detail_px, speck), LENS)
    assert not any(half_an_hour(judge, dirty) for _ in range(HALF_HOURS + 1))


def test_a_person_who_stands_there_for_twenty_minutes_is_no_dirt(judge, pictures, clean, detail_px) -> None:
    dirty = look_at_parts(disc(pictures, detail_px, speck), LENS)
    assert not any(judge.judge(dirty) for _ in range(20))
    assert not any(judge.judge(clean) for _ in range(20))


def test_a_lamp_that_is_switched_on_for_the_first_time_is_no_dirt(judge, pictures) -> None:
    across = np.linspace(2.0, 0.4, 640)[None, :, None]  # it lights one side, and the camera exposes for less
    lit = [np.clip(each * across, 0, 255).astype(np.uint8) for each in pictures]
    assert half_an_hour(judge, look_at_parts(lit, LENS)) == ""


def test_a_target_that_stands_there_is_not_judged(judge, pictures, detail_px) -> None:
    outline = np.array(detail_px) + np.array([[-32.0, -32.0], [32.0, -32.0], [32.0, 32.0], [-32.0, 32.0]])
    covered = look_at_parts(disc(pictures, detail_px, speck), LENS, [outline])
    assert half_an_hour(judge, covered) == ""


def test_in_the_dark_what_was_found_stays_and_nothing_new_is(judge, pictures, clean, detail_px) -> None:
    dark = np.full_like(clean, np.inf)
    assert half_an_hour(judge, dark) == ""
    words = half_an_hour(judge, look_at_parts(disc(pictures, detail_px, drop), LENS))
    assert half_an_hour(judge, dark) == words != ""
