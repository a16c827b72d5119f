"""Where the camera is, from rendered pictures of tags in a room."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.frame import Frame
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.detectors.tag import TagDetector, TagOptions
from stadimeter.perception.prediction import MOVED_FRAMES, CameraLocator
from support.scenes.placed import CAMERA, moved, placed_scene
from support.scenes.render import render

pytestmark = pytest.mark.vision

DETECTOR = TagDetector("landmarks", TagOptions.model_validate({"side": "10 cm"}))
SCENE = placed_scene(7)
IMAGE = render(SCENE.scene).image


def frame(number=0, image=IMAGE):
    return Frame(image, number / 30, number)


def locator_for(scene):
    return CameraLocator(scene.landmarks, DETECTOR, Viewpoint())


def test_a_picture_of_four_tags_tells_the_cameras_pose_to_a_part_of_a_per_cent():
    pose = locator_for(SCENE).locate(frame(), CAMERA)
    assert pose.tags == (10, 11, 12, 13)
    assert math.dist(pose.position_m, SCENE.position_m) < 0.002 * SCENE.distance_m
    yaw = math.atan2(SCENE.turn[1, 2], SCENE.turn[0, 2])
    assert pose.angles_rad[:2] == pytest.approx((yaw, math.asin(SCENE.turn[2, 2])), abs=math.radians(0.1))


def test_tags_that_the_configuration_does_not_know_are_left_out():
    known = replace(SCENE, landmarks=replace(SCENE.landmarks, tags=SCENE.landmarks.tags[:2]))
    pose = locator_for(known).locate(frame(), CAMERA)
    assert pose.tags == tuple(sorted(tag.number for tag in known.landmarks.tags))


def test_a_moved_tag_is_trouble_once_several_frames_in_a_row_say_so():
    locator = locator_for(moved(SCENE, 0.2))
    number = SCENE.landmarks.tags[0].number
    for count in range(1, MOVED_FRAMES + 1):
        assert locator.trouble() == ""
        assert locator.locate(frame(count), CAMERA).moved == (number,)
    assert locator.trouble() == f"tag {number} is not where the configuration says"
    locator.locate(frame(9, np.full_like(IMAGE, 128)), CAMERA)
    assert locator.trouble() == ""
