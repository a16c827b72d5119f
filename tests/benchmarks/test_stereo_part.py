"""The benchmark of two cameras moves targets rightly into the other camera's frame, and counts what is measured."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from support.stereo import in_right, known_exactly, true_rig


@pytest.fixture(scope="module")
def rig():
    return known_exactly(true_rig(8))


@pytest.mark.parametrize("name", ["ball", "sheet", "tag", "disc"])
def test_the_right_camera_sees_the_same_target_from_where_it_is(rig, name) -> None:
    from stereo import scenes_of

    pair = scenes_of(name, 8, rig)
    assert pair.right.target.position_m == pytest.approx(in_right(np.array([pair.left.target.position_m]), rig)[0])
    if name != "ball":
        assert pair.right.target.outline_m() == pytest.approx(in_right(pair.left.target.outline_m(), rig), abs=1e-12)
    assert pair.left.seed != pair.right.seed


@pytest.mark.long
def test_each_way_of_measuring_has_a_sample_and_a_pair_without_the_target_has_no_distance(rig) -> None:
    from stereo import JOINED, WAYS, measure_scenes, scenes_of

    pair = scenes_of("tag", 9, rig)
    made = measure_scenes("tag", 9, pair, rig)
    assert [each.method for each in made if each.method in WAYS] == list(WAYS)
    assert all(each.measured_m == pytest.approx(each.true_m, rel=0.02) for each in made if each.method in WAYS)
    gone = measure_scenes("tag", 9, replace(pair, right=replace(pair.right, target=_far(pair.right.target))), rig)
    assert [each.measured_m for each in gone] == [None] * 3
    assert gone[-1].method == JOINED


def _far(target):
    """Return the same target so far away that no detector finds it."""
    far = tuple(40 * each for each in target.position_m)
    return replace(target, pose=replace(target.pose, position_m=far))


def test_facts_have_the_names_of_the_goals(rig) -> None:
    from goals import GROUPS
    from samples import Sample
    from stereo import TARGETS, WAYS, _facts

    sample = Sample(row="", method="", seed=1, apparent_px=30.0, true_m=2.0, measured_m=2.01, sigma_m=0.02)
    facts = _facts([replace(sample, row=name, method=way) for name in TARGETS for way in WAYS])
    assert {name for goal in GROUPS["stereo"] for name in goal.limits} <= facts.keys()
    assert facts["stereo ball together median"] == pytest.approx(0.005)
    assert not math.isnan(facts["stereo sheet joined held"])
