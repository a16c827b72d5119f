"""The parts of the report count right, so that it can be believed."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.detection import Detection, DetectionStatus
from support.scenes import draw
from support.scenes.cut_sheet import GroupTarget
from support.scenes.draw import CAMERA, disc_scene
from support.scenes.hard_flats import hard_tape
from support.scenes.on_floor import HEIGHT_M, ball_on_floor, sheet_on_floor, tag_lying
from support.scenes.render import render
from support.stereo import in_right, known_exactly, true_rig

pytestmark = pytest.mark.vision


# The part of the report on the floor compares what it says it does.


def test_what_is_drawn_stands_on_the_floor() -> None:
    for drawn, distance_m in ((ball_on_floor(1, 2.0), 2.0), (tag_lying(1, 0.7), 0.7)):
        x, y, z = drawn.scene.target.position_m
        # Down from the camera is (0, cos t, -sin t), but for the roll.
        below_m = y * math.cos(drawn.tilt_rad) - z * math.sin(drawn.tilt_rad)
        radius_m = getattr(drawn.scene.target, "diameter_m", 0.0) / 2
        assert below_m + radius_m == pytest.approx(drawn.height_m, abs=0.005)
        assert math.sqrt(x * x + y * y + z * z - below_m**2) == pytest.approx(distance_m, rel=1e-3)
    corners = sheet_on_floor(1, 1.0).scene.target.outline_m()
    assert len(corners) == 4
    assert abs(HEIGHT_M - sheet_on_floor(1, 1.0).height_m) < 0.02


@pytest.mark.long
def test_each_cell_has_three_figures_and_the_floor_s_are_those_of_the_floor() -> None:
    from floor import BOTH, DISTANCES_M, FLOOR, KINDS, SIZE, facts_of, samples_of

    samples = samples_of(1)
    assert len(samples) == 3 * len(KINDS) * len(DISTANCES_M)
    ball = {each.method: each for each in samples if each.row == "ball, 1 m"}
    assert ball[SIZE].measured_m != ball[FLOOR].measured_m
    assert min(ball[SIZE].measured_m, ball[FLOOR].measured_m) <= ball[BOTH].measured_m
    assert facts_of(samples)["floor median"] < 0.2


# The table of hard flat things counts right: which of two strips was measured, and what is another thing.


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


# The part of the report on objects that a network finds.


@pytest.mark.long
def test_people_are_measured_within_what_people_and_boxes_differ() -> None:
    import objects

    samples = [each for seed in draw.TUNING_SEEDS[500:508] for each in objects.samples_of(seed)]
    assert {each.row for each in samples} == {row.name for row in objects.ROWS}
    assert all(each.measured_m is not None for each in samples)
    assert all(abs(each.error) < 4 * each.sigma_m / each.measured_m for each in samples)
    assert all(0.04 < each.sigma_m / each.measured_m < 0.12 for each in samples)


@pytest.mark.long
def test_the_part_has_a_line_and_figures_for_each_row() -> None:
    import objects

    part = objects.run(2, 1, draw.TUNING_SEEDS.start)
    for row in objects.ROWS:
        assert f"| {row.name} | 2 |" in part.text
        assert {f"object {row.name} median", f"object {row.name} held"} <= set(part.facts)


# The tables of posters, of circles and of targets under water count what was measured.


@pytest.mark.long
@pytest.mark.vision
def test_posters_are_counted_by_size_and_another_one_is_not_found() -> None:
    import picture_accuracy

    rows = {each.row: each for each in picture_accuracy.samples_of(3)}
    assert rows["300 px"].measured_m == pytest.approx(rows["300 px"].true_m, rel=0.005)
    assert rows["another poster"].measured_m is None


@pytest.mark.long
@pytest.mark.vision
def test_circles_are_counted_by_size_and_those_of_another_spacing_are_not_found() -> None:
    import circles_accuracy
    from by_row import facts_by_row, table_by_row

    samples = circles_accuracy.samples_of(3)
    rows = {each.row: each for each in samples}
    assert rows["200 px"].measured_m == pytest.approx(rows["200 px"].true_m, rel=0.005)
    assert rows["14 cm apart"].measured_m is None
    facts = facts_by_row("circles", samples)
    assert abs(facts["circles 200 px bias"]) == facts["circles 200 px median"]
    assert (facts["circles 200 px found"], facts["circles 14 cm apart found"]) == (1.0, 0.0)
    assert len(table_by_row("side", samples).splitlines()) == 2 + len(rows)


def test_rays_through_the_window_come_back_to_their_pixels() -> None:
    import under_water

    from support.scenes.water import CAMERA, INDEX

    pixels = np.array([[10.0, 20.0], [319.5, 239.5], [600.0, 470.0]])
    assert CAMERA.project(CAMERA.directions(pixels)) == pytest.approx(pixels)
    assert under_water.TOLD.fx_px == pytest.approx(INDEX * draw.CAMERA.fx_px)


# The table of what is found on real pictures counts right.

SHEET = [(100.0, 100.0), (300.0, 110.0), (290.0, 250.0), (95.0, 240.0)]
BALL = (120.0, 90.0, 40.0)


def test_a_sheet_is_found_from_whichever_corner_it_is_told() -> None:
    from recall import is_quad

    assert is_quad(SHEET, SHEET)
    assert is_quad(SHEET, [*SHEET[2:], *SHEET[:2]])
    assert is_quad(SHEET, SHEET[::-1])
    assert is_quad(SHEET, [(x + 3, y - 2) for x, y in SHEET])


def test_a_sheet_elsewhere_of_another_size_or_with_more_corners_is_not_the_sheet() -> None:
    from recall import is_quad

    assert not is_quad(SHEET, [(x + 40, y) for x, y in SHEET])
    assert not is_quad(SHEET, [(195 + 1.1 * (x - 195), 175 + 1.1 * (y - 175)) for x, y in SHEET])
    assert not is_quad(SHEET, [*SHEET, (90.0, 170.0)])


def test_a_ball_is_found_by_part_of_its_rim_and_not_by_another_circle() -> None:
    from recall import _circle, is_circle

    assert is_circle([BALL], _circle(BALL)[:14])
    assert is_circle([(0.0, 0.0, 10.0), BALL], _circle(BALL))
    assert not is_circle([BALL], _circle((120.0, 90.0, 43.0)))
    assert not is_circle([BALL], _circle((130.0, 90.0, 40.0)))


def test_the_plain_method_and_the_tutorial_see_what_is_plain_to_see() -> None:
    import tutorial
    from recall import _circle, is_circle, is_quad, plain_ball, plain_sheet

    image = np.full((480, 640, 3), (70, 90, 110), np.uint8)
    cv2.fillPoly(image, [np.array(SHEET, np.int32)], (235, 235, 235))
    assert is_quad(SHEET, plain_sheet(image, 1.45))
    ball = np.full((480, 640, 3), (70, 90, 110), np.uint8)
    cv2.circle(ball, (300, 200), 60, (60, 220, 230), cv2.FILLED, cv2.LINE_AA)
    assert is_circle([(300.0, 200.0, 60.0)], plain_ball(ball))
    found = tutorial.ball_circle(ball, np.array((25, 80, 80)), np.array((35, 255, 255)))
    assert is_circle([(300.0, 200.0, 60.0)], _circle(found))


# The table of things of unknown size counts right, so that it can be believed.


@pytest.mark.parametrize("kind", ["ball", "disc", "sheet", "tag"])
def test_a_size_that_the_detector_is_not_told_is_learnt_in_a_sequence(kind) -> None:
    from size_from_motion import ASSUMED_M, _Sequence

    (sample,) = _Sequence(kind, 2.0, 3, np.random.default_rng(3)).samples((0.5,))
    assert sample.row == f"{kind}, 2 m, 0.5 m"
    assert sample.true_m > 1.2 * ASSUMED_M
    assert 0 < abs(sample.error) < 0.08
    assert 0.02 < sample.sigma_m / sample.measured_m < 0.03


def test_a_sequence_whose_end_is_not_seen_counts_as_one_without_an_answer(monkeypatch) -> None:
    import size_from_motion

    sequence = size_from_motion._Sequence("tag", 2.0, 3, np.random.default_rng(3))
    look = sequence._look
    monkeypatch.setattr(sequence, "_look", lambda ahead_m: look(ahead_m) if ahead_m < 0.5 else None)
    (sample,) = sequence.samples((0.5,))
    assert sample.measured_m is None


# The benchmark of two cameras moves targets rightly into the other camera's frame, and counts what is measured.


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
