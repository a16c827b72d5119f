"""The table of hard flat things counts right: which of two strips was measured, and what is another thing."""

from __future__ import annotations

import math

import pytest

from stadimeter.core.detection import Detection, DetectionStatus
from support.scenes.cut_sheet import GroupTarget
from support.scenes.draw import CAMERA, disc_scene
from support.scenes.hard_flats import hard_tape
from support.scenes.render import render


@pytest.fixture(scope="module")
def pair():
    flat = next(flat for flat in map(hard_tape, range(50)) if flat.twins)
    assert isinstance(flat.scene.target, GroupTarget)
    return flat.scene, render(flat.scene)


def judged(pair, centre_px, status=DetectionStatus.FOUND):
    from hard_flats import _of_nearest
    from samples import Sample

    scene, made = pair
    sample = Sample(
        row="tape", method="stadimeter", seed=1, apparent_px=30.0, true_m=made.truth.distance_m, measured_m=2.0
    )
    return _of_nearest(sample, Detection(target="tape", status=status, centre_px=centre_px), scene, made)


def test_a_strip_is_compared_with_its_own_distance_and_the_twin_with_the_twin_s(pair) -> None:
    scene, made = pair
    sample, is_elsewhere = judged(pair, tuple(made.truth.outline_px.mean(axis=0)))
    assert (sample.true_m, is_elsewhere) == (made.truth.distance_m, False)
    twin = scene.target.others[0]
    corners = twin.outline_m()
    centre = CAMERA.project(corners[:, :2] / corners[:, 2:]).mean(axis=0)
    sample, is_elsewhere = judged(pair, tuple(centre))
    assert (sample.true_m, is_elsewhere) == (math.hypot(*twin.position_m), False)


def test_what_lies_beside_both_strips_is_another_thing(pair) -> None:
    _, made = pair
    corner = made.truth.outline_px[0] + 3 * (made.truth.outline_px[0] - made.truth.outline_px.mean(axis=0))
    assert judged(pair, tuple(corner))[1]
    assert not judged(pair, (0.0, 0.0), DetectionStatus.NOT_FOUND)[1]


def test_another_thing_that_is_said_to_be_ambiguous_is_not_held_against_it() -> None:
    from hard_flats import FlatSample, _unsaid
    from samples import Sample

    sample = Sample(row="", method="stadimeter", seed=1, apparent_px=30.0, true_m=1.0, measured_m=2.0)
    kinds = {"table": "disc", "kinds": ("all",), "sample": sample}
    silent, said = (FlatSample(**kinds, is_elsewhere=True, is_said=each) for each in (False, True))
    right = FlatSample(**kinds)
    assert _unsaid([silent, said, right, right]) == 0.25


def test_what_is_met_is_measured_with_a_camera_file_and_single_troubles_with_the_true_camera() -> None:
    from hard_flats import DISC, GRID, _measured

    scene = disc_scene(3, 0.3, plain=True)
    met, single = (_measured(name, ("all",), scene, "disc").sample for name in (DISC, GRID))
    assert met.measured_m == single.measured_m
    # The edge bias of either side, 0.1 px, as a share of what the disc measures across.
    of_bias = 2 * 0.1 / met.apparent_px
    assert (met.sigma_m**2 - single.sigma_m**2) ** 0.5 / met.measured_m == pytest.approx(of_bias, rel=0.1)
