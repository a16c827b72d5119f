"""Several targets of one kind: each keeps its slot, whatever crosses it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.frame import Frame
from stadimeter.perception.perceiver import Perceiver, assign
from stadimeter.perception.prediction import SEARCH_EVERY_S
from support.crossing_balls import BLANK, HIDDEN_SHARE, RATE_HZ, Follower, PretendBalls, appearances, courses
from support.crossing_people import Crossing
from support.scenes.draw import CAMERA, TUNING_SEEDS


class Counting(PretendBalls):
    """Counts how often it is asked for what."""

    def __init__(self, places, seed: int = 1) -> None:
        super().__init__(places, seed)
        self.searches: list[int] = []
        self.looks = 0

    def detect_all(self, frame: Frame, *, lens: object = None) -> tuple[Detection, ...]:
        if lens is not None:
            self.searches.append(frame.sequence)
        return super().detect_all(frame)

    def detect_near(self, frame: Frame, prediction: Prediction, *, lens: object = None) -> Detection:
        self.looks += 1
        return super().detect_near(frame, prediction)

    def _is_found(self, seen) -> bool:
        return seen.covered < 0.5


def still(*places: tuple[float, float, float], frames: int = 90):
    return np.tile(np.array(places), (frames, 1, 1))


def follow(detector: PretendBalls, places, balls: int) -> Follower:
    follower = Follower(detector, balls)
    for number, place in enumerate(places):
        follower.step(BLANK, number, appearances(place))
    return follower


def passing(frames: int = 60):
    """One ball that passes before another one, which moves the other way."""
    at = np.linspace(-1, 1, frames)
    near = np.stack([0.3 * at, 0 * at, 1.0 + 0 * at], axis=1)
    far = np.stack([-0.5 * at, 0.02 + 0 * at, 1.6 + 0 * at], axis=1)
    return np.stack([near, far], axis=1)


def statuses(follower: Follower) -> Sequence[bool]:
    return [each.track.is_valid for each in follower.state.tracks]


def test_balls_that_pass_each_other_keep_their_names() -> None:
    places = passing()
    follower = follow(Counting(places), places, 2)
    assert follower.swaps == 0
    assert sorted(follower.ball_of.values()) == [0, 1]


@pytest.mark.long
@pytest.mark.parametrize("is_crossing", [False, True])
def test_four_balls_keep_their_names_for_ten_seconds(is_crossing: bool) -> None:
    for seed in TUNING_SEEDS[1:3]:
        places = courses(seed, 4, 10.0, is_crossing=is_crossing)
        follower = follow(PretendBalls(places, seed), places, 4)
        in_sight = sum(each.covered < HIDDEN_SHARE for place in places for each in appearances(place))
        assert follower.swaps == 0
        assert follower.tracked > 0.9 * in_sight
        assert (in_sight < 4 * len(places)) is is_crossing


def test_a_ball_behind_another_one_is_not_found_and_the_reason_names_it() -> None:
    places = passing()
    follower = Follower(Counting(places), 2)
    reasons: list[str] = []
    for number, place in enumerate(places):
        follower.step(BLANK, number, appearances(place))
        tracks = {each.track.target: each.track for each in follower.state.tracks}
        reasons += [track.reason for track in tracks.values() if "hidden" in track.reason]
    assert set(reasons) == {"hidden behind balls-1"}


def test_the_whole_frame_is_searched_once_for_all_and_once_a_second() -> None:
    places = still((-0.2, 0, 1), (0, 0, 1.2), (0.3, 0, 1.4))
    detector = Counting(places)
    follow(detector, places, 3)
    assert len(detector.searches) == len(set(detector.searches)), "once in a frame at most"
    assert detector.searches == [0, *[round(n * SEARCH_EVERY_S * RATE_HZ) for n in (1, 2)]]
    assert detector.looks == 3 * 89


def test_with_a_free_slot_a_newcomer_is_seen_within_a_quarter_of_a_second() -> None:
    places = still((-0.2, 0, 1), (0, 0, -1.0), frames=60)  # the second is behind the camera
    places[40:, 1, 2] = 1.2
    follower = Follower(Counting(places), 2)
    seen_in = [
        number
        for number, place in enumerate(places)
        if (follower.step(BLANK, number, appearances(place)) or all(statuses(follower)))
    ]
    assert 40 < seen_in[0] <= 40 + math.ceil(0.25 * RATE_HZ) + 2


def test_a_ball_that_leaves_frees_its_slot_for_another_one() -> None:
    places = still((-0.3, 0, 1), (0, 0, 1.2), (0.3, 0, -1.0), frames=120)
    places[30:, 1, 2] = -1.0
    places[60:, 2, 2] = 1.4
    follower = follow(Counting(places), places, 2)
    assert sorted(follower.ball_of.values()) != [0, 1]
    assert statuses(follower) == [True, True]


class Numbered(Counting):
    """Its targets have numbers, and which place has which is turned round half way."""

    numbers = (7, 3)

    def detect_all(self, frame: Frame, *, lens: object = None) -> tuple[Detection, ...]:
        order = (3, 7) if frame.sequence < 20 else (7, 3)
        seen = sorted(super().detect_all(frame, lens=lens), key=lambda each: each.centre_px)
        self._seen = [replace(each, number=number) for each, number in zip(seen, order, strict=True)]
        return tuple(self._seen)


def test_a_target_with_a_number_is_told_by_it_and_not_by_its_place() -> None:
    detector = Numbered(still((-0.2, 0, 1), (0.2, 0, 1)))
    perceiver = Perceiver({"tags-7": detector, "tags-3": detector}, CAMERA)
    for number in range(40):
        found, _ = perceiver.look(Frame(BLANK, number / RATE_HZ, number), {})
        assert {each.target: each.number for each in found} == {"tags-7": 7, "tags-3": 3}


class Greedy(Counting):
    """Finds the largest near a prediction, as the real detector may where it is unsure of the place."""

    def detect_near(self, frame: Frame, prediction: Prediction, *, lens: object = None) -> Detection:
        super().detect_near(frame, prediction)
        near = [
            each for each in self._seen if math.dist(each.centre_px, prediction.centre_px) < 5 * prediction.sigma_px
        ]
        return max(near, key=lambda each: each.width_px, default=self._missing)

    _missing = Detection(target="balls", status=DetectionStatus.NOT_FOUND, reason="not there")


def test_a_new_ball_beside_a_larger_one_is_confirmed_all_the_same() -> None:
    places = still((-0.05, 0, 1), (0.05, 0, 1.2), frames=4)
    assert statuses(follow(Greedy(places), places, 2)) == [True, True]


# Who gets which detection: the least total cost, whatever the costs.

UNASSIGNED = 50.0
COSTS = st.one_of(st.floats(-60, 60), st.integers(0, 3).map(float), st.just(math.inf))


@st.composite
def tables(draw: st.DrawFn) -> list[list[float]]:
    rows, columns = draw(st.integers(0, 5)), draw(st.integers(0, 5))
    return [[draw(COSTS) for _ in range(columns)] for _ in range(rows)]


@given(tables())
def test_no_detection_is_given_twice_and_each_goes_to_whom_it_fits_best_of_those_left(costs: list[list[float]]) -> None:
    given_to = assign(costs, UNASSIGNED)
    taken = [j for j in given_to if j is not None]
    assert len(set(taken)) == len(taken)
    for i, row in enumerate(costs):
        for j, cost in enumerate(row):
            own = given_to[i]
            holder = given_to.index(j) if j in taken else None
            is_settled = own is not None and row[own] <= cost
            assert cost >= UNASSIGNED or is_settled or (holder is not None and costs[holder][j] <= cost)


@pytest.mark.long
def test_people_who_cross_keep_their_names_but_for_one_change_a_minute_and_their_distances_are_within_sigma() -> None:
    """Twenty scenes of 40 s, in which two walk past each other every four seconds."""
    scenes = [Crossing(seed, 40.0) for seed in range(20)]
    for scene in scenes:
        scene.run()
    crossings, minutes = sum(each.crossings for each in scenes), 20 * 40 / 60
    assert crossings > 150
    assert sum(each.changes for each in scenes) <= minutes
    assert sum(each.seen for each in scenes) > 0.85 * sum(each.boxes for each in scenes)
    error, sigma = np.array([error for scene in scenes for error in scene.errors]).T
    assert np.median(np.abs(error)) < 0.07
    assert np.quantile(np.abs(error), 0.95) < 0.15
    assert 0.90 < np.mean(np.abs(error) < 1.96 * sigma) < 0.99


def test_a_person_who_walks_behind_another_one_keeps_the_name_and_the_reason_names_the_other() -> None:
    at = np.linspace(-1, 1, 40)
    near, far = np.stack([0 * at, 0 * at + 4.5], axis=1), np.stack([1.8 * at, 0 * at + 6.0], axis=1)
    scene = Crossing(1, 4.0, places=np.stack([near, far], axis=1))
    scene.run()
    assert (scene.crossings, scene.changes, len(scene.who)) == (1, 0, 2)
    assert "hidden behind people-1" in scene.reasons


def test_a_person_who_leaves_frees_the_name_for_another_one() -> None:
    places = np.tile(np.array([(-1.0, 5.0), (1.0, 5.0), (0.0, -1.0)]), (120, 1, 1))
    places[30:, 1], places[60:, 2] = (0.0, -1.0), (0.5, 6.0)
    scene = Crossing(2, 12.0, people=3, places=places, names=2)
    scene.run()
    assert sorted(scene.who.values()) == [0, 2]
