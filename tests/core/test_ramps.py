"""Ramps: how strongly they act at a distance."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decision import RuleStatus
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.rule import RampRule
from stadimeter.core.rules.ramp import describe_ramp, new_ramp, ramp_level, step_ramp

# Ramps.

FAR = RampRule(name="far", target="ball", output="motor", start=3.0, full=6.0, level_min=0.25)
NEAR = RampRule(name="near", target="ball", output="motor", start=1.0, full=0.2)


def level(rule, distance_m, sigma_m=0.0, *, is_on=False):
    return ramp_level(rule, distance_m, sigma_m, sigma_m, is_on=is_on)


def test_it_grows_with_distance():
    assert [level(FAR, d) for d in (1, 3, 4.5, 6, 9)] == pytest.approx([0, 0, 0.625, 1, 1])


def test_it_grows_with_nearness_when_full_is_nearer_than_the_start():
    assert [level(NEAR, d) for d in (2, 1, 0.6, 0.2, 0.1)] == pytest.approx([0, 0, 0.5, 1, 1])


def test_just_past_the_start_it_has_its_minimum():
    assert level(FAR, 3.0001) == pytest.approx(0.25, abs=1e-3)


@pytest.mark.parametrize("status", [TrackStatus.SEARCHING, TrackStatus.LOST])
def test_a_ramp_without_its_target_asks_for_nothing(status):
    track = Track(target="ball", status=status, distance_m=5.0, sigma_m=0.1)
    inputs = RuleInputs(tracks={"ball": track}, now_s=0.0)
    step = step_ramp(FAR, replace(new_ramp(FAR), level=0.5), inputs)
    assert step.requests == ()
    assert step.trace.status is RuleStatus.UNKNOWN
    assert step.level == 0.0


# How strongly a ramp acts at a distance.

TABLE = RampRule(
    name="lamp", target="ball", output="lamp", start=3.0, full=1.0, points=((1.0, 1.0), (2.0, 0.5), (3.0, 0.2))
)
PARKING = replace(TABLE, points=((1.0, 0.0), (2.0, 1.0), (3.0, 0.0)))

distances_m = st.floats(0, 50)
sigmas_m = st.floats(0, 2)
levels = st.floats(0, 1)
biases = st.sampled_from(["neutral", "cautious", "quiet"])


@st.composite
def tables(draw, *, is_rising=False):
    at_m = sorted(draw(st.sets(st.floats(0.1, 20), min_size=2, max_size=6)))
    height = draw(st.lists(levels, min_size=len(at_m), max_size=len(at_m)))
    points = tuple(zip(at_m, sorted(height) if is_rising else height, strict=True))
    return RampRule(
        name="r", target="ball", output="o", start=at_m[0], full=at_m[-1], points=points, bias=draw(biases),
        dead_zone=draw(st.just(0.0) | levels),
    )  # fmt: skip


@st.composite
def curves(draw):
    start_m, full_m = draw(st.floats(0, 20)), draw(st.floats(0, 20))
    assume(abs(start_m - full_m) > 1e-3)
    low, high = sorted((draw(levels), draw(levels)))
    return RampRule(
        name="r", target="ball", output="o", start=start_m, full=full_m, level_min=low, level_max=high,
        gamma=draw(st.floats(0.2, 4)), bias=draw(biases), dead_zone=draw(st.just(0.0) | levels),
    )  # fmt: skip


ramps = tables() | curves()


def ball(distance_m, sigma_m=0.0):
    track = Track(target="ball", status=TrackStatus.TRACKING, distance_m=distance_m, sigma_m=sigma_m)
    return RuleInputs(tracks={"ball": track}, now_s=0.0)


def test_between_two_points_the_level_is_in_proportion_and_beyond_the_ends_it_stays():
    found = [level(TABLE, distance_m) for distance_m in (0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 99.0)]
    assert found == pytest.approx([1.0, 1.0, 0.75, 0.5, 0.35, 0.2, 0.2])


def test_a_cautious_table_is_as_strong_as_anywhere_within_the_standard_deviation():
    assert level(replace(PARKING, bias="cautious"), 1.8, 0.3) == 1.0
    assert level(replace(PARKING, bias="quiet"), 1.8, 0.3) == 0.5


def test_levels_in_the_dead_zone_are_off():
    rule = replace(TABLE, dead_zone=0.3)
    assert level(rule, 2.5) == pytest.approx(0.35)
    assert level(rule, 2.8) == 0.0


def test_noise_at_the_dead_zone_does_not_switch_it_off():
    rule = replace(TABLE, dead_zone=0.3)
    assert level(rule, 2.7, 0.05, is_on=True) == 0.3
    assert level(rule, 2.7, 0.05, is_on=False) == 0.0
    assert level(rule, 2.9, 0.05, is_on=True) == 0.0


def test_the_reason_names_the_table():
    assert describe_ramp(TABLE, ball(1.5, 0.01)) == (
        "1.50 m ± 0.01: 75% by the table from 1.00 m (100%) to 3.00 m (20%)"
    )


@given(ramps, distances_m, sigmas_m, st.booleans())
def test_a_level_is_always_off_or_from_the_dead_zone_to_the_highest_of_the_rule(rule, distance_m, sigma_m, is_on):
    found = level(rule, distance_m, sigma_m, is_on=is_on)
    highest = max(height for _, height in rule.points) if rule.points else rule.level_max
    assert found == 0.0 or rule.dead_zone <= found <= max(highest, rule.dead_zone)
    assert 0.0 <= found <= 1.0


@given(tables(is_rising=True), distances_m, distances_m, sigmas_m)
def test_a_table_that_rises_gives_no_less_further_away(rule, one_m, other_m, sigma_m):
    near_m, far_m = sorted((one_m, other_m))
    assert level(rule, near_m, sigma_m) <= level(rule, far_m, sigma_m)


@given(curves(), distances_m, distances_m, sigmas_m, st.booleans())
def test_a_curve_gives_no_less_nearer_to_its_full_end(rule, one_m, other_m, sigma_m, is_on):
    nearer, further = sorted((one_m, other_m), reverse=rule.full < rule.start)
    assert level(rule, nearer, sigma_m, is_on=is_on) <= level(rule, further, sigma_m, is_on=is_on)


@given(ramps, distances_m, sigmas_m)
def test_cautious_is_never_weaker_than_neutral_and_quiet_never_stronger(rule, distance_m, sigma_m):
    cautious, neutral, quiet = (
        level(replace(rule, bias=bias), distance_m, sigma_m) for bias in ("cautious", "neutral", "quiet")
    )
    assert cautious >= neutral >= quiet


@given(ramps, distances_m, sigmas_m)
def test_being_on_never_makes_it_weaker(rule, distance_m, sigma_m):
    assert level(rule, distance_m, sigma_m, is_on=True) >= level(rule, distance_m, sigma_m, is_on=False)


def test_a_level_is_never_more_than_one_whatever_is_rounded():
    rule = replace(TABLE, points=((0.1, 0.0), (math.nextafter(0.1, 1.0), 1.0)))
    assert 0.0 <= level(rule, 0.1) <= level(rule, 0.2) == 1.0
