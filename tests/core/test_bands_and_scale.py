"""A deadband is against noise. An error of the scale is the same in every frame, and needs none."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.compounds import judge
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.evidence import collect_evidence, describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.rule import RampRule
from stadimeter.core.rules.ramp import ramp_level
from support.conditions import separation
from support.each_case import each_case

NEAR = DistanceCondition(below=0.5, target="ball")
FAR = DistanceCondition(above=2.0, target="ball")


def ball(distance_m, noise_m=0.002, scale_sigma=0.1, target="ball", **more):
    """Return a target of which the noise is known, and the scale is not."""
    return Track(
        target=target,
        status=TrackStatus.TRACKING,
        distance_m=distance_m,
        depth_m=distance_m,
        sigma_m=math.hypot(noise_m, scale_sigma * distance_m),
        noise_m=noise_m,
        **{"closing_mps": 0.0, "closing_sigma_mps": 0.05, "bearing_rad": 0.0, "elevation_rad": 0.0, **more},
    )


def holds(condition, *tracks, is_active=False):
    inputs = RuleInputs(tracks={each.target: each for each in tracks}, now_s=1.0)
    return judge(condition, inputs, (), is_active=is_active).value


def test_an_uncalibrated_camera_moves_where_an_alarm_begins_and_not_where_it_ends():
    assert holds(NEAR, ball(0.49)) is False
    assert holds(NEAR, ball(0.47)) is True
    assert holds(NEAR, ball(0.50), is_active=True) is True
    assert holds(NEAR, ball(0.51), is_active=True) is False
    assert holds(FAR, ball(1.98), is_active=True) is False


def test_noise_makes_the_deadband_wide_and_the_rest_of_what_is_unsure_does_not():
    inputs = RuleInputs(tracks={"ball": ball(0.5, noise_m=0.02)}, now_s=1.0)
    words = describe_verdict(NEAR, inputs, (), is_active=True, with_probability=True)
    assert words == "0.50 m ± 0.05, below 0.56 m: P 0.87, ends at 0.50"
    (found,) = collect_evidence(NEAR, inputs, (), is_active=True)
    assert (found.begins_at, found.ends_at) == ("0.47 m", "0.56 m")
    assert found.sigma == pytest.approx(math.hypot(0.02, 0.05))


@each_case("broken", [math.nan, math.inf, -math.inf])
@each_case(
    "condition",
    [NEAR, separation(targets=("ball", "tag"), below=1.0), TimeToContactCondition(below_s=2.0, target="ball")],
)
def test_with_a_noise_that_is_no_number_nothing_is_known(condition, broken):
    tracks = ball(0.4, noise_m=0.01), ball(0.4, target="tag")
    assert holds(condition, replace(tracks[0], noise_m=broken), tracks[1]) is None


def test_two_targets_come_apart_by_the_noise_of_both():
    apart = separation(targets=("ball", "tag"), below=1.0)
    tag = ball(3.0, 0.03, target="tag")
    assert holds(apart, ball(1.80, 0.04), tag, is_active=True) is False  # 1.2 m; the band is 3 · 0.05 m
    assert holds(apart, ball(1.90, 0.04), tag, is_active=True) is True


SOON = TimeToContactCondition(below_s=2.0, target="ball", deadband_s=0.0)


def test_an_unsure_scale_hardly_makes_the_time_to_contact_unsure():
    coming = {"closing_mps": 1.0, "closing_sigma_mps": 0.01}
    assert holds(SOON, ball(1.98, **coming)) is True
    assert holds(SOON, ball(1.98, **coming, scale_sigma=0.3)) is True
    (found,) = collect_evidence(SOON, RuleInputs(tracks={"ball": ball(2.0, **coming)}, now_s=1.0), (), is_active=True)
    assert found.sigma == pytest.approx(math.hypot(0.002, 2 * 0.01))
    assert found.ends_at == "2.04 s"


def test_where_contact_is_at_a_distance_the_scale_counts_for_that_distance():
    coming = {"closing_mps": 1.0, "closing_sigma_mps": 0.01}
    there = replace(SOON, contact_m=0.5)
    (found,) = collect_evidence(there, RuleInputs(tracks={"ball": ball(2.5, **coming)}, now_s=1.0), (), is_active=False)
    assert found.sigma == pytest.approx(math.hypot(0.002, 2 * 0.01, 0.1 * 0.5))
    assert found.value == pytest.approx(2.0)


limits = st.builds(
    lambda low_m, width_m, sides: {
        "above": low_m if "above" in sides else None,
        "below": low_m + width_m if "below" in sides else None,
    },
    st.floats(0.3, 4),
    st.floats(0.1, 2),
    st.sampled_from(["above", "below", "above and below"]),
)


@given(
    limits,
    st.sampled_from([(None, 0.5), (0.3, 0.3), (0.5, 0.5), (0.7, 0.5), (0.9, 0.5), (0.9, 0.2), (0.9, 0.9)]),
    st.sampled_from([1.0, 2.0, 3.0]),
    st.floats(-0.3, 0.3),
    st.tuples(st.floats(0, 0.02), st.sampled_from([0.0, 0.02, 0.1, 0.15])),
    st.lists(st.floats(-1, 1), min_size=2, max_size=20),
)
def test_noise_within_the_deadband_raises_or_clears_an_alarm_once_at_most(
    ends, probabilities, sigmas, off_limit, shares, wobble
):
    (on, off), (noise_share, scale_sigma) = probabilities, shares
    distance_m = (ends["above"] or ends["below"]) * (1 + off_limit)
    condition = DistanceCondition(**ends, probability_on=on, probability_off=off, deadband_sigmas=sigmas, target="ball")
    # From end to end 0.7 of the deadband: where a high probability is asked for to go on, the scale takes of it.
    reach_m = 0.35 * sigmas * noise_share * distance_m
    is_active = bool(holds(condition, ball(distance_m, noise_share * distance_m, scale_sigma)))
    transitions = 0
    for share in wobble:
        there = ball(distance_m + share * reach_m, noise_share * distance_m, scale_sigma)
        value = bool(holds(condition, there, is_active=is_active))
        transitions += value is not is_active
        is_active = value
    assert transitions <= 1


TABLE = RampRule(name="r", target="ball", output="o", start=1.0, full=3.0, points=((1.0, 0.0), (2.0, 1.0), (3.0, 0.0)))
CURVES = [
    RampRule(name="r", target="ball", output="o", start=start_m, full=full_m, level_min=0.2)
    for start_m, full_m in ((1.0, 3.0), (3.0, 1.0))
]


@given(
    st.sampled_from([replace(TABLE, dead_zone=0.2), *CURVES]),
    st.sampled_from(["neutral", "cautious", "quiet"]),
    st.floats(0.5, 1.6) | st.floats(2.4, 3.5),
    st.floats(0, 0.2),
    st.floats(0, 0.4),
    st.floats(-0.99, 0.99),
)
def test_noise_does_not_switch_a_ramp_off_whatever_its_bias_and_its_scale(
    rule, bias, distance_m, noise_m, scale_m, share
):
    rule, sigma_m = replace(rule, bias=bias), math.hypot(noise_m, scale_m)
    if ramp_level(rule, distance_m, sigma_m, noise_m, is_on=False) > 0:
        moved_m = distance_m + 2 * share * noise_m
        assert ramp_level(rule, moved_m, sigma_m, noise_m, is_on=True) > 0
