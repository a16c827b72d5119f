"""Ramps."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decision import RuleStatus
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.rule import RampRule
from stadimeter.core.rules.ramp import new_ramp, ramp_level, step_ramp

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


def test_noise_at_the_start_does_not_switch_it_off():
    assert level(FAR, 2.95, 0.05, is_on=False) == 0.0
    assert level(FAR, 2.95, 0.05, is_on=True) == 0.25
    assert level(FAR, 2.85, 0.05, is_on=True) == 0.0


def test_it_may_err_on_the_side_that_is_asked_for():
    neutral = level(NEAR, 0.6, 0.1)
    assert level(replace(NEAR, bias="cautious"), 0.6, 0.1) > neutral > level(replace(NEAR, bias="quiet"), 0.6, 0.1)


@given(st.floats(0, 20), st.floats(0, 20), st.floats(0.2, 4))
def test_it_is_monotonic_and_within_its_limits(a, b, gamma):
    rule = RampRule(name="r", target="t", start=2.0, full=8.0, level_min=0.1, level_max=0.9, gamma=gamma)
    low, high = sorted((a, b))
    assert 0 <= level(rule, low) <= level(rule, high) <= 0.9


@pytest.mark.parametrize("status", [TrackStatus.SEARCHING, TrackStatus.LOST])
def test_a_ramp_without_its_target_asks_for_nothing(status):
    track = Track(target="ball", status=status, distance_m=5.0, sigma_m=0.1)
    inputs = RuleInputs(tracks={"ball": track}, now_s=0.0)
    step = step_ramp(FAR, replace(new_ramp(FAR), level=0.5), inputs)
    assert step.requests == ()
    assert step.trace.status is RuleStatus.UNKNOWN
    assert step.level == 0.0
