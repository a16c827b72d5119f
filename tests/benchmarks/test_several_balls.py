"""The benchmark of several balls measures what it says."""

from __future__ import annotations

import pytest

from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from support.crossing_balls import appearances, courses, picture_of
from support.scenes.draw import CAMERA, TUNING_SEEDS


@pytest.mark.long
@pytest.mark.parametrize("is_crossing", [False, True])
def test_four_balls_keep_their_names_for_ten_seconds(is_crossing: bool) -> None:
    import several_balls

    figures = several_balls.count_swaps(TUNING_SEEDS[1:3], 10.0, is_crossing=is_crossing)
    assert figures.swaps == 0
    assert (figures.crossings > 5) is is_crossing
    assert figures.tracked > 0.9


def test_balls_that_change_places_at_a_stroke_are_counted_as_swaps(monkeypatch: pytest.MonkeyPatch) -> None:
    import several_balls

    unchanged = several_balls.count_swaps(TUNING_SEEDS[:1], 1.0, balls=2, is_crossing=False)
    monkeypatch.setattr("several_balls.courses", lambda *_, **__: _exchanged())
    changed = several_balls.count_swaps(TUNING_SEEDS[:1], 1.0, balls=2, is_crossing=False)
    assert (unchanged.swaps, changed.swaps > 0) == (0, True)


def _exchanged():
    places = courses(TUNING_SEEDS[0], 2, 1.0, is_crossing=False).copy()
    places[:, :, 2] = 1.2  # as large, so that nothing but the place tells them apart
    places[15:, [0, 1]] = places[15:, [1, 0]]
    return places


def test_a_rendered_picture_shows_each_ball_where_it_is() -> None:
    places = courses(TUNING_SEEDS[0], 4, 0.1, is_crossing=False)[0]
    import several_balls

    found = several_balls.several(4).detect_all(Frame(picture_of(places, 1), 0.0, 0), lens=CAMERA)
    assert [each.status for each in found] == [DetectionStatus.FOUND] * 4
    truth = sorted(each.centre_px for each in appearances(places))
    for seen, true in zip(sorted(each.centre_px for each in found), truth, strict=True):
        assert seen == pytest.approx(true, abs=0.5)
