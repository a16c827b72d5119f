"""Where the camera is, from the corners of tags of known places, without pictures."""

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Landmarks, PlacedTag
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.ranging.camera_pose import ExpectedPose, SeenLandmark, locate_camera

pytestmark = pytest.mark.vision

CAMERA = CameraModel.with_focal_length(1000.0, 1280, 960)
SIGMA_PX = 0.04
WITHIN_6 = 12.592
"""95 % of chi-square with six degrees of freedom."""

WALL = (
    PlacedTag(number=1, side_m=0.1, position_m=(0.0, -0.6, 0.5), facing_rad=0.3),
    PlacedTag(number=2, side_m=0.1, position_m=(0.1, 0.6, 0.6), facing_rad=-0.2, roll_rad=math.pi),
    PlacedTag(number=3, side_m=0.1, position_m=(0.0, -0.5, 1.2), tilt_rad=-0.3),
    PlacedTag(number=4, side_m=0.2, position_m=(0.6, 0.1, 0.05), tilt_rad=math.pi / 2),
)
"""Three tags on a wall that faces along x, one of them upside down and one tilted, and one on the floor before it."""

PLACE_M = (2.2, 0.3, 0.8)
YAW, TILT, ROLL = math.pi - 0.15, -0.1, 0.03


def turn_of(yaw, tilt, roll):
    """Return the camera's axes in the room as columns, from turns about z, y and x one after the other."""
    about = [cv2.Rodrigues(np.array(each))[0] for each in ((0, 0, yaw), (0, -tilt, 0), (roll, 0, 0))]
    body = about[0] @ about[1] @ about[2]
    return np.column_stack((-body[:, 1], -body[:, 2], body[:, 0]))


def corners_m(tag):
    """Return a tag's corners in the room, by hand: its own right and top turned by roll, tilt and facing in turn."""
    about = [cv2.Rodrigues(np.array(each))[0] for each in ((0, 0, tag.facing_rad), (0, -tag.tilt_rad, 0))]
    axes = about[0] @ about[1] @ cv2.Rodrigues(np.array((-tag.roll_rad, 0.0, 0.0)))[0]
    square = np.array(((0, -1, 1), (0, 1, 1), (0, 1, -1), (0, -1, -1))) * tag.side_m / 2
    return square @ axes.T + tag.position_m


def see(tag, place_m=PLACE_M, turn=None, rng=None, wrong=None):
    """Return a tag as a camera sees it: with the noise of its sides, and placed a little wrong."""
    turn = turn_of(YAW, TILT, ROLL) if turn is None else turn
    room_m = corners_m(tag)
    if wrong is not None:
        turned = cv2.Rodrigues(rng.normal(0, wrong[1], 3))[0]
        room_m = (room_m - tag.position_m) @ turned.T + tag.position_m + rng.normal(0, wrong[0], 3)
    seen_m = (room_m - place_m) @ turn
    corners = CAMERA.project(seen_m[:, :2] / seen_m[:, 2:])
    if rng is not None:
        corners = corners + rng.normal(0, SIGMA_PX, (4, 2))
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    found = Detection(
        target="landmarks",
        status=DetectionStatus.FOUND,
        outline_px=corners,
        width_px=sides[0],
        height_px=sides[1],
        size_sigma_px=SIGMA_PX,
        number=tag.number,
    )
    return SeenLandmark(tag, found)


def located(seen, camera=CAMERA, expected=None, at_s=1.0, **how):
    landmarks = Landmarks(tags=tuple(each.tag for each in seen), **how)
    return locate_camera(seen, landmarks, camera, expected or ExpectedPose(Viewpoint()), at_s)


def square_of(pose, place_m=PLACE_M, turn=None):
    """Return how far a pose is off, in standard deviations, squared."""
    turn = turn_of(YAW, TILT, ROLL) if turn is None else turn
    off = np.concatenate(
        (np.array(pose.position_m) - place_m, cv2.Rodrigues(turn_of(*pose.angles_rad) @ turn.T)[0].ravel())
    )
    return float(off @ np.linalg.solve(np.reshape(pose.covariance, (6, 6)), off))


@pytest.mark.parametrize("numbers", [(1, 2, 3, 4), (2, 3), (4,), (2,)])
def test_exact_corners_give_the_exact_pose(numbers):
    pose = located([see(tag) for tag in WALL if tag.number in numbers])
    assert pose.tags == numbers
    assert pose.moved == ()
    assert pose.position_m == pytest.approx(PLACE_M, abs=1e-5)
    assert pose.angles_rad == pytest.approx((YAW, TILT, ROLL), abs=1e-5)


def test_the_95_percent_region_holds_the_truth_as_often_as_it_says():
    squares = []
    for seed in range(80):
        rng = np.random.default_rng((seed, 1))
        wrong = (0.005, math.radians(0.5))
        pose = located([see(tag, rng=rng, wrong=wrong) for tag in WALL])
        squares.append(square_of(pose))
    assert 0.90 <= np.mean(np.array(squares) < WITHIN_6) <= 0.99
    assert 4.5 < np.mean(squares) < 7.5  # six in the mean


def test_standard_deviations_of_the_angles_are_what_the_angles_scatter_by():
    found = [
        located([see(tag, rng=rng, wrong=(0.005, math.radians(0.5))) for tag in WALL[:2]])
        for rng in (np.random.default_rng((seed, 2)) for seed in range(60))
    ]
    scatter = np.std([(*each.position_m, *each.angles_rad) for each in found], axis=0)
    assert scatter == pytest.approx(np.mean([each.sigmas for each in found], axis=0), rel=0.35)


def test_an_unsure_focal_length_makes_the_distance_from_one_tag_unsure_and_not_the_place_between_many():
    unsure = replace(CAMERA, focal_relative_sigma=0.02)
    one = located([see(WALL[1])], unsure, place_sigma_m=0.0, facing_sigma_rad=0.0)
    all_four = located([see(tag) for tag in WALL], unsure, place_sigma_m=0.0, facing_sigma_rad=0.0)
    distance_m = math.dist(PLACE_M, WALL[1].position_m)
    assert math.hypot(*one.sigmas[:2]) == pytest.approx(0.02 * distance_m, rel=0.5)
    assert math.hypot(*all_four.sigmas[:2]) < 0.2 * math.hypot(*one.sigmas[:2])


def test_a_tag_that_was_moved_is_named_and_left_out():
    stale = replace(WALL[1], position_m=(0.1, 0.6, 0.75))
    seen = [see(tag) for tag in WALL]
    pose = located([SeenLandmark(stale, seen[1].found), *(seen[each] for each in (0, 2, 3))])
    assert (pose.tags, pose.moved) == ((1, 3, 4), (2,))
    assert pose.position_m == pytest.approx(PLACE_M, abs=1e-4)
    assert "tag 2 is not where the configuration says" in pose.in_words()


def test_of_two_tags_that_contradict_each_other_neither_is_believed():
    stale = replace(WALL[1], position_m=(0.1, 0.6, 0.75))
    pose = located([see(WALL[0]), SeenLandmark(stale, see(WALL[1]).found)])
    assert pose.position_m is None
    assert pose.reason.startswith("tags 1 and 2 contradict each other")
    assert pose.in_words() == pose.reason


def test_two_of_four_tags_that_were_moved_leave_nobody_to_believe():
    shelf = [replace(tag, position_m=(x, y, z + 0.3)) for tag in WALL[:2] for x, y, z in (tag.position_m,)]
    seen = [see(tag) for tag in WALL]
    pose = located([*(SeenLandmark(tag, each.found) for tag, each in zip(shelf, seen, strict=False)), *seen[2:]])
    assert pose.position_m is None
    assert "contradict" in pose.reason


SMALL = PlacedTag(number=9, side_m=0.02, position_m=(0.0, 0.0, 0.8))
BELOW_M, LEVEL = (2.0, 0.0, 0.5), turn_of(math.pi, 0.0, 0.0)
"""A tag of 10 px, looked at a little from below: it may as well be seen from above."""


def ambiguous(expected=None, at_s=1.0):
    return located([see(SMALL, BELOW_M, LEVEL)], expected=expected, at_s=at_s)


def test_one_tag_that_may_be_seen_from_two_places_tells_neither():
    pose = ambiguous()
    assert pose.position_m is None
    assert pose.reason.startswith("tag 9 may be seen from two places")


@pytest.mark.parametrize("height_m", [0.5, 1.1])
def test_height_and_tilt_of_the_camera_tell_which_of_two_places_it_is(height_m):
    tilt = 0.0 if height_m == 0.5 else -2 * math.atan2(0.3, 2.0)
    pose = ambiguous(ExpectedPose(Viewpoint(height_m=height_m, tilt_rad=tilt)))
    assert pose.position_m[2] == pytest.approx(height_m, abs=0.05)


@pytest.mark.parametrize(("later_s", "is_known"), [(0.05, True), (2.0, False), (0.0, False)])
def test_the_pose_before_tells_which_of_two_places_it_is_for_a_moment(later_s, is_known):
    before = located([see(SMALL, BELOW_M, LEVEL), see(WALL[0], BELOW_M, LEVEL), see(WALL[1], BELOW_M, LEVEL)], at_s=1.0)
    pose = ambiguous(ExpectedPose(Viewpoint(), before), 1.0 + later_s)
    assert (pose.position_m is not None) is is_known
    assert not is_known or pose.position_m == pytest.approx(BELOW_M, abs=0.02)


def test_what_is_no_flat_square_tells_no_place():
    seen = see(WALL[1])
    bent = replace(seen.found, outline_px=seen.found.outline_px + np.array(((0, 0), (6, 0), (0, 0), (0, 0))))
    pose = located([SeenLandmark(seen.tag, bent)])
    assert pose.position_m is None
    assert "not those of a flat square" in pose.reason


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("seed", range(40))
def test_whatever_corners_are_seen_the_answer_is_a_finite_pose_or_a_reason(seed):
    rng = np.random.default_rng((seed, 3))
    seen = [see(tag) for tag in WALL[: 1 + seed % 4]]
    for number in range(1 + seed % 2):
        corners = rng.uniform(0, 900, (4, 2))
        if seed % 5 == 0:
            corners[:, 1] = corners[:, 0]  # on a line
        if seed % 7 == 0:
            corners[rng.integers(4)] = math.nan
        if seed % 11 == 0:
            corners[1] = corners[0]
        tag, found = seen[number % len(seen)]
        seen[number % len(seen)] = SeenLandmark(tag, replace(found, outline_px=corners))
    pose = located(seen)
    assert (pose.position_m is None) is bool(pose.reason)
    assert np.isfinite((*(pose.position_m or ()), *(pose.orientation or ()), *pose.covariance)).all()
