"""What a view of the background says of the camera, against rendered rooms of exactly known poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.errors import CalibrationError
from stadimeter.perception.mounting import MountingJudge, ViewMotion, fit_view_motion, keep_still, look_at
from support.watched_room import FOCAL_PX, LENS, LIGHT_AGAIN_AT, Pose, WatchedRoom

NOON, NIGHT, DARK = 720, 1400, 120


@pytest.fixture(scope="module")
def room() -> WatchedRoom:
    return WatchedRoom(seed=31)


@pytest.fixture(scope="module")
def saved(room):
    return keep_still([look_at(room.pictures(NOON + each / 100), LENS) for each in range(3)])


def judged(judge, room, minute, pose, times):
    return [judge.judge(look_at(room.pictures(minute + each, pose), LENS)) for each in range(times)][-1]


def test_a_turn_and_a_zoom_are_measured_within_three_of_their_sigmas(room, saved) -> None:
    pose = Pose(pan_deg=0.6, tilt_deg=-0.4, roll_deg=0.8, zoom=0.012)
    motion = look_at(room.pictures(NOON + 5, pose), LENS).compare(saved).motion
    measured = (*(math.degrees(each) for each in (motion.pan_rad, motion.tilt_rad, motion.roll_rad)), motion.zoom)
    sigmas = (*(math.degrees(each) for each in motion.sigmas[:3]), motion.sigmas[3])
    for value, truth, sigma in zip(measured, (0.6, -0.4, 0.8, 0.012), sigmas, strict=True):
        assert abs(value - truth) < 3 * sigma
    assert math.degrees(max(motion.sigmas[:2])) < 0.05


def test_the_fit_finds_an_exact_motion_among_a_third_of_wrong_matches() -> None:
    rng = np.random.default_rng(8)
    now = rng.uniform(-0.5, 0.5, (150, 2))
    motion = ViewMotion(pan_rad=0.01, tilt_rad=-0.02, roll_rad=0.015, zoom=0.02, sigmas=(0.0,) * 4, inliers=100)
    before = motion.undo(now)
    now[:50] = rng.uniform(-0.5, 0.5, (50, 2))
    found, agrees = fit_view_motion(before, now, FOCAL_PX, 15)
    assert agrees[50:].all()
    for name in ("pan_rad", "tilt_rad", "roll_rad", "zoom"):
        assert getattr(found, name) == pytest.approx(getattr(motion, name), abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "pose"), [("moved", Pose(pan_deg=0.2)), ("zoomed", Pose(zoom=-0.01)), ("refocused", Pose(blur_px=2.0))]
)
def test_what_was_done_to_the_camera_is_found_with_the_second_check_and_not_before(room, saved, kind, pose) -> None:
    judge = MountingJudge([saved])
    assert not judged(judge, room, NOON + 20, pose, 1).settled
    assert kind in judged(judge, room, NOON + 21, pose, 1).settled


def test_a_camera_that_stays_is_not_said_to_be_moved_by_day_or_by_night(room, saved) -> None:
    judge = MountingJudge([saved])
    for minute in (NOON + 60, 1150, NIGHT):
        assert not judged(judge, room, minute, None, 1).found


def test_in_the_dark_it_is_not_judged(saved) -> None:
    rng = np.random.default_rng(1)
    dark = [rng.integers(0, 6, (480, 640, 3)).astype(np.uint8) for _ in range(2)]
    found = MountingJudge([saved]).judge(look_at(dark, LENS))
    assert "too dark" in found.not_judged
    assert not found.found


def test_a_camera_that_saw_nothing_for_a_day_and_a_night_is_darkened(saved) -> None:
    judge, black = MountingJudge([saved]), look_at([np.zeros((480, 640, 3), np.uint8)] * 4, LENS)
    assert not any(judge.judge(black).settled for _ in range(24 * 60 - 1))
    assert "for a day and a night" in judge.judge(black).settled["darkened"]
    judge = MountingJudge([saved])
    for _ in range(3):
        assert not any(judge.judge(black).settled for _ in range(12 * 60))
        judge.judge(saved)


@pytest.mark.long
def test_a_turn_is_found_as_soon_as_there_is_light_again(room, saved) -> None:
    judge, pose = MountingJudge([saved]), Pose(tilt_deg=0.2)
    assert judged(judge, room, LIGHT_AGAIN_AT - 3, pose, 3).not_judged
    assert "moved" in judged(judge, room, LIGHT_AGAIN_AT, pose, 2).settled


def test_another_room_is_not_recognised_after_three_checks(saved) -> None:
    other, judge = WatchedRoom(seed=77), MountingJudge([saved])
    assert not judged(judge, other, NOON, None, 2).settled
    assert "nothing of the saved view" in judged(judge, other, NOON + 2, None, 1).settled["unrecognised"]


def test_what_moves_is_not_kept(room) -> None:
    looks = [look_at(room.pictures(NOON), LENS), look_at(room.pictures(NOON, Pose(pan_deg=1.0)), LENS)]
    with pytest.raises(CalibrationError, match="that stand still"):
        keep_still(looks)


def test_no_feature_of_a_target_is_kept(room) -> None:
    target = np.array([[200.0, 100.0], [400.0, 100.0], [400.0, 300.0], [200.0, 300.0]])
    places = LENS.project(look_at(room.pictures(NOON), LENS, [target]).features["place"])
    inside = (places > (205, 105)).all(axis=1) & (places < (395, 295)).all(axis=1)
    assert len(places)
    assert not inside.any()


@pytest.mark.long
def test_a_view_is_learnt_as_seen_from_the_saved_place(room, saved) -> None:
    sparse = replace(saved, data=saved.features[::3].tobytes())  # too little of it is in sight to decide alone
    judge = MountingJudge([sparse], rotation_rad=math.radians(1), zoom=0.002)
    for minute in (960, 1290, NIGHT):
        judged(judge, room, minute, Pose(pan_deg=0.4), 1)
    assert len(judge.views) > 1
    again = look_at(room.pictures(NIGHT + 2), LENS).compare(judge.views[-1]).motion
    assert math.degrees(again.rotation_rad) < 0.1, "the turn of 0.4° is taken out of what was learnt"


def test_where_enough_of_the_saved_view_is_in_sight_it_decides_alone(room, saved) -> None:
    turned = look_at(room.pictures(NOON + 1, Pose(pan_deg=0.1)), LENS)  # as if learnt with an error of 0.1 degrees
    judge = MountingJudge([saved, turned])
    best = judge.judge(look_at(room.pictures(NOON + 2, Pose(pan_deg=0.2)), LENS)).best
    assert math.degrees(best.motion.pan_rad) == pytest.approx(0.2, abs=0.05)
