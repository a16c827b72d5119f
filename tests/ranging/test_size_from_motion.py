"""The size of a thing from how it grows while the camera moves by known steps."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import CalibrationError
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import DiscShape, SheetShape, TagShape
from stadimeter.ranging.measure import SeenTarget, measure
from stadimeter.ranging.size_from_motion import StepErrors, StepView, learn_size, view_of

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
EXACT = StepErrors(scale_share=0.0, place_m=1e-4, aim_rad=0.0, turn_rad=0.0)
TYPED = StepErrors()
# The true size, in assumed ones.
FACTOR = 1.7
AHEAD = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.25), (0.0, 0.0, 0.5))


def views(moves_m, place_m=(0.2, 0.1, 2.0), factor=FACTOR, share=0.001, names="abcdefgh") -> list[StepView]:
    """Return where a thing is located that is `factor` times as large as assumed, without noise."""
    seen = []
    for name, moved_m in zip(names, moves_m, strict=False):
        position_m = (np.array(place_m) - moved_m) / factor
        noise_m = share * float(np.linalg.norm(position_m))
        seen.append(
            StepView(
                picture=f"{name}.jpg",
                moved_m=moved_m,
                position_m=tuple(position_m.tolist()),
                outwards_m=noise_m,
                across_m=noise_m / 10,
            )
        )
    return seen


@pytest.mark.parametrize("errors", [EXACT, TYPED])
@pytest.mark.parametrize(
    "moves_m",
    [
        AHEAD,
        AHEAD[:2],
        ((0.0, 0.0, 0.0), (0.0, 0.0, -0.4), (0.0, 0.0, -0.8)),
        ((0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.8, -0.3, 0.0)),
        ((0.0, 0.0, 0.0), (0.1, 0.0, 0.3), (-0.2, 0.1, 0.6)),
    ],
)
def test_a_thing_that_stands_still_has_its_exact_size_whichever_way_the_camera_goes(moves_m, errors) -> None:
    made = learn_size(views(moves_m), CAMERA, errors)
    assert made.factor == pytest.approx(FACTOR, rel=1e-6)
    assert made.is_proved == (len(moves_m) > 2)


def test_the_parts_of_the_uncertainty_add_up() -> None:
    camera = replace(CAMERA, focal_relative_sigma=0.01)
    made = learn_size(views(AHEAD), camera, TYPED)
    parts = (made.edges_share, made.lens_share, made.turn_share, made.steps_share)
    assert made.sigma_share == pytest.approx(math.hypot(*parts))
    # Through a focal length that is 1 % too long, the size is 1 % too large.
    assert made.lens_share == pytest.approx(0.01, rel=0.02)
    assert made.steps_share > TYPED.scale_share


def test_what_errs_alike_in_all_pictures_grows_as_the_two_apparent_sizes_say() -> None:
    # An edge bias of e px is the share 2 e / P of a distance, so it moves near positions by less than far ones.
    bias_px, focal_px, size_m = 0.1, 600.0, 0.1
    seen = [
        replace(each, lasting_m=2 * bias_px / (focal_px * size_m) * np.linalg.norm(each.position_m) ** 2)
        for each in views(AHEAD[::2], place_m=(0.0, 0.0, 2.0))
    ]
    sizes_px = [focal_px * size_m / each.position_m[2] for each in seen]
    made = learn_size(seen, CAMERA, EXACT)
    assert made.lens_share == pytest.approx(2 * bias_px * sum(1 / each for each in sizes_px), rel=1e-6)


def test_the_interval_holds_over_random_steps_and_pictures() -> None:
    rng = np.random.default_rng(5)
    errors = StepErrors(scale_share=0.02, place_m=0.003, aim_rad=0.04, turn_rad=0.02)
    camera = replace(CAMERA, focal_relative_sigma=0.01)
    off = []
    for _ in range(400):
        with suppress(CalibrationError):  # two of a hundred are taken for a thing that moved, or a wrong step
            off.append(_deviate(rng, errors, camera))
    assert len(off) >= 392
    assert 0.92 < np.mean(np.abs(np.array(off)) < 1.96) < 0.98
    assert abs(np.mean(off)) < 0.15


def _deviate(rng: np.random.Generator, errors: StepErrors, camera: CameraModel) -> float:
    """Return how far off a size is that was learnt from steps that err as they may, in its standard deviations."""
    place_m = np.array((rng.uniform(-0.5, 0.5), rng.uniform(-0.3, 0.3), 2.0))
    scale, aim = 1 + errors.scale_share * rng.normal(), errors.aim_rad * rng.normal(size=3)
    longer = 1 + camera.focal_relative_sigma * rng.normal()
    seen = []
    for each in views(AHEAD, share=0.002):
        moved_m = np.array(each.moved_m)
        there_m = place_m - scale * (moved_m + np.cross(aim, moved_m)) - errors.place_m * rng.normal(size=3)
        there_m = (there_m + np.cross(errors.turn_rad * rng.normal(size=3), there_m)) / FACTOR
        there_m += each.outwards_m * rng.normal() * there_m / np.linalg.norm(there_m)
        there_m += each.across_m * rng.normal(size=3) * (1, 1, 0)
        position_m = tuple((there_m * (1, 1, longer)).tolist())
        seen.append(replace(each, position_m=position_m))
    made = learn_size(seen, camera, errors)
    return (made.factor / FACTOR - 1) / made.sigma_share


SHAPES = [
    BallShape(diameter_m=0.1),
    DiscShape(diameter_m=0.1),
    SheetShape(width_m=0.15, height_m=0.1),
    TagShape(side_m=0.1),
]


def _scaled(shape, factor):
    lengths = {key: factor * getattr(shape, key) for key in shape.__struct_fields__ if key.endswith("_m")}
    return replace(shape, **lengths)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.label.partition(" ")[0])
def test_every_shape_of_another_size_is_located_in_the_same_direction_so_many_times_as_far(shape, seen_ball) -> None:
    found = seen_ball((0.3, -0.1, 2.0), 0.06)
    if shape.has_corners:
        corners_px = np.array(((280.0, 190.0), (352.0, 200.0), (347.0, 252.0), (283.0, 245.0)))
        found = replace(found, outline_px=corners_px, width_px=68.0, height_px=53.0, centre_px=(315.0, 221.0))
    first, second = (_scaled(shape, factor).locate(found, CAMERA) for factor in (1.0, 3.7))
    assert second.position_m == pytest.approx([3.7 * each for each in first.position_m], rel=1e-6)
    assert second.noise_share == pytest.approx(first.noise_share, rel=1e-6)
    assert second.systematic_share == pytest.approx(first.systematic_share, rel=1e-6)


def test_a_ball_is_learnt_from_its_outlines_near_by_where_its_limb_is_nearer_than_its_centre(seen_ball) -> None:
    shape, seen = BallShape(diameter_m=0.1), []
    for way_m in (0.0, 0.2, 0.3):
        found = seen_ball((0.1, 0.05, 0.7 - way_m), 0.123)
        target = SeenTarget(detection=found, measurement=measure(found, shape, CAMERA, 0.0), shape=shape)
        seen.append(view_of(f"{way_m}", target, CAMERA, (0.0, 0.0, way_m)))
    assert learn_size(seen, CAMERA, EXACT).factor == pytest.approx(2.46, rel=1e-3)


def refusal(seen: list[StepView], errors: StepErrors = TYPED) -> str:
    with pytest.raises(CalibrationError) as refused:
        learn_size(seen, CAMERA, errors)
    return str(refused.value)


def test_a_thing_that_moved_is_refused_and_the_picture_is_named() -> None:
    moves_m = [(0.0, 0.0, 0.2 * each) for each in range(5)]
    seen = views(moves_m)
    x, y, z = seen[2].position_m
    seen[2] = replace(seen[2], position_m=(x, y, z - 0.1 / FACTOR))
    words = refusal(seen)
    assert words.startswith("the thing moved, or the steps are wrong: c.jpg fits worst, it is ")


def shares_of_wrong_steps(series: int, places: int, wrong_m: float) -> tuple[float, float]:
    """Return which share of series is refused, and which share of the others is within the 95 % interval.

    One step of 25 cm, any of them, is shorter than stated; places and edges err as much as they are stated to.
    """
    refused, inside = 0, []
    for number in range(series):
        rng = np.random.default_rng((number, places, 12))
        first_wrong = int(rng.integers(1, places))
        seen = []
        for at, each in enumerate(views([(0.0, 0.0, 0.25 * each) for each in range(places)], share=0.0015)):
            there_m = np.array(each.position_m) * FACTOR + (0, 0, wrong_m * (at >= first_wrong))
            there_m += TYPED.place_m * rng.normal(size=3)
            turned_m = there_m + np.cross(TYPED.turn_rad * rng.normal(size=3), there_m)
            there_m = turned_m / np.linalg.norm(turned_m) * np.linalg.norm(there_m) / FACTOR
            there_m *= 1 + 0.0015 * rng.normal()
            seen.append(replace(each, position_m=tuple(there_m.tolist())))
        try:
            made = learn_size(seen, CAMERA, TYPED)
        except CalibrationError:
            refused += 1
        else:
            inside.append(abs(made.factor / FACTOR - 1) < 1.96 * made.sigma_share)
    return refused / series, float(np.mean(inside)) if inside else 1.0


@pytest.mark.parametrize("series", [25, pytest.param(200, marks=pytest.mark.long)])
@pytest.mark.parametrize("places", [3, 4, 5])
def test_a_step_that_is_wrong_by_a_tenth_of_the_way_is_found_and_right_steps_are_not_refused(series, places) -> None:
    """Of three places 25 and 20 cm apart, stated as 25 and 25, the size would be 13 % off."""
    found, _ = shares_of_wrong_steps(series, places, 0.25 * (places - 1) / 10)
    refused, inside = shares_of_wrong_steps(series, places, 0.0)
    assert found >= min(0.95, 1 - 2 / series)
    assert refused <= max(0.02, 1 / series)
    assert inside > 0.92


def test_a_way_that_is_too_short_is_refused_with_how_far_to_go() -> None:
    moves_m = [(0.0, 0.0, 0.004 * each) for each in range(3)]
    assert "so its size is not known" in refusal(views(moves_m, share=0.01))
    moves_m = [(0.0, 0.0, 0.015 * each) for each in range(3)]
    words = refusal(views(moves_m))
    assert "more than ± 20%, over 3 cm; move the camera about " in words
