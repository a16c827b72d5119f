"""Several tags in one picture, each a target of its own."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from stadimeter.app.clock import SteppedClock
from stadimeter.config.plugins import DriverContext
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.detectors.tag import TagDetector, TagOptions
from stadimeter.perception.perceiver import Perceiver
from support.scenes.cut_sheet import GroupTarget
from support.scenes.draw import CAMERA
from support.scenes.plane import Pose, TagTarget
from support.scenes.render import render
from support.scenes.scene import Scene

PLACES = {3: (-0.2, 0.0, 1.0), 7: (0.1, 0.1, 1.2), 9: (0.25, -0.1, 1.1)}


def options(**more: Any) -> TagOptions:
    return TagOptions.model_validate({"side": "10 cm", "family": "apriltag-36h11", **more})


def detector(**more: Any) -> TagDetector:
    return options(**more).build(DriverContext(name="tags", clock=SteppedClock()))


def frame(number: int = 0) -> Frame:
    tags = [
        TagTarget(pose=Pose(position_m=place), side_m=0.1, family="apriltag-36h11", number=each)
        for each, place in PLACES.items()
    ]
    scene = Scene(camera=CAMERA, target=GroupTarget(first=tags[0], others=tuple(tags[1:])), seed=2)
    return Frame(render(scene).image, number / 30, number)


@pytest.mark.long
def test_each_named_tag_is_measured_under_its_number() -> None:
    several = detector(ids=[9, 3])
    perceiver = Perceiver({"tags-9": several, "tags-3": several}, CAMERA)
    for number in range(3):
        _, measured = perceiver.look(frame(number))
        depths_m = {each.target: each.depth_m for each in measured}
        assert depths_m == {"tags-9": pytest.approx(1.1, rel=0.01), "tags-3": pytest.approx(1.0, rel=0.01)}


@pytest.mark.long
def test_a_named_tag_that_is_not_there_is_missing_and_no_other_one_stands_in() -> None:
    several = detector(ids=[3, 4])
    perceiver = Perceiver({"tags-3": several, "tags-4": several}, CAMERA)
    _, measured = perceiver.look(frame())
    assert [each.status for each in measured] == [MeasurementStatus.MEASURED, MeasurementStatus.NOT_FOUND]


@pytest.mark.long
def test_any_tags_get_slots_and_say_their_numbers() -> None:
    several = detector(count=4)
    perceiver = Perceiver(dict.fromkeys(("tags-1", "tags-2", "tags-3", "tags-4"), several), CAMERA)
    found, _ = perceiver.look(frame())
    assert {each.number for each in found} == {3, 7, 9, None}


def test_the_names_of_the_targets_are_the_numbers() -> None:
    assert options(ids=[3, 7]).members == ("3", "7")
    assert options(count=2).members == ("1", "2")
    assert options(id=3).members == ()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"ids": [3, 7, 3]}, "3 is given twice"),
        ({"ids": [3, 587]}, "587 is not in apriltag-36h11"),
        ({"ids": [3], "count": 2}, "ids and count are given; write id for one tag, ids for these, or count for any"),
    ],
)
def test_numbers_that_cannot_be_meant_are_refused(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        options(**wrong)
