"""The figures behind a condition, and where it would turn."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Not, judge
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.evidence import collect_evidence
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.sight import CountCondition, PresenceCondition
from stadimeter.core.measurement import Track, TrackStatus
from support.conditions import closing, direction, separation

NEAR = DistanceCondition(below=2.0, probability_on=0.8, probability_off=0.5, deadband_sigmas=3.0, target="ball")


def track(distance_m=2.1, sigma_m=0.1, target="ball", **more):
    figures = {
        "depth_m": distance_m,
        "closing_mps": 1.0,
        "closing_sigma_mps": 0.1,
        "closing_cov_m2ps": 0.0,
        "bearing_rad": 0.2,
        "elevation_rad": 0.0,
        "status": TrackStatus.TRACKING,
        "since_s": 4.0,
    }
    return Track(target=target, distance_m=distance_m, sigma_m=sigma_m, **{**figures, **more})


def inputs(*tracks, **more):
    return RuleInputs(tracks={each.target: each for each in tracks or (track(),)}, now_s=10.0, **more)


def of(condition, *tracks, is_active=False, held=(), **more):
    return collect_evidence(condition, inputs(*tracks, **more), held, is_active=is_active)


def test_a_distance_comes_with_all_its_figures():
    (found,) = of(NEAR, track(1.95))
    assert (found.quantity, found.about, found.unit) == ("distance", ("ball",), "m")
    assert (found.value, found.sigma, found.low, found.high) == (1.95, 0.1, None, 2.0)
    assert found.probability == pytest.approx(0.691, abs=1e-3)
    assert found.holds is False
    assert found.words == "ball 1.95 m ± 0.10, below 2.00 m: P 0.69, begins at 0.80"


def test_it_tells_where_the_condition_would_begin_and_where_it_would_end():
    (found,) = of(NEAR, track(1.95))
    assert found.begins_at == "1.92 m"
    assert found.ends_at == "2.32 m"


def test_a_standard_deviation_that_grows_with_distance_is_counted_as_it_will_be_there():
    (far,) = of(NEAR, track(4.0, 0.4))
    (there,) = of(NEAR, track(2.0, 0.1))
    assert far.begin_points == pytest.approx(there.begin_points)


def test_while_it_holds_the_deadband_is_in_the_limit():
    (found,) = of(NEAR, track(2.1), is_active=True)
    assert found.holds is True
    assert found.high == pytest.approx(2.0 + 3 * 0.1 * (2.0 / 2.1) ** 2)


def test_between_two_limits_it_turns_at_two_figures():
    between = replace(NEAR, above=1.0)
    (found,) = of(between, track(1.5, 0.02))
    first, second = found.begin_points
    assert 1.0 < first < 1.02
    assert 1.96 < second < 2.0
    assert found.begins_at == f"{first:.2f} m or {second:.2f} m"


def test_a_condition_that_is_too_unsure_to_begin_anywhere_says_so_by_saying_nothing():
    narrow = replace(NEAR, above=1.9)
    (found,) = of(narrow, track(1.95, 0.5))
    assert found.begin_points == ()
    assert found.begins_at == ""


def test_a_plain_comparison_turns_at_its_limits():
    plain = replace(NEAR, probability_on=None, deadband_sigmas=0.0, deadband=0.1)
    (found,) = of(plain)
    assert found.probability is None
    assert (found.begins_at, found.ends_at) == ("2.00 m", "2.10 m")


def test_an_angle_is_told_in_degrees_and_nothing_is_claimed_of_how_sure_it_is():
    (found,) = of(direction(above=math.radians(20), deadband=math.radians(2), target="ball"))
    assert (found.quantity, found.unit, found.sigma, found.probability) == ("bearing", "rad", None, None)
    assert (found.begins_at, found.ends_at) == ("20.0°", "18.0°")
    assert found.words.endswith("how sure a direction is, is not known")


def test_a_closing_speed_turns_at_a_speed():
    fast = closing(above=0.5, probability_on=0.8, deadband_sigmas=2.0, target="ball")
    (found,) = of(fast)
    assert (found.begins_at, found.ends_at) == ("0.58 m/s", "0.30 m/s")


def test_a_time_to_contact_comes_with_the_standard_deviation_of_the_ratio():
    soon = TimeToContactCondition(below_s=2.0, probability_on=0.8, deadband_sigmas=0.0, target="ball")
    (found,) = of(soon)
    assert (found.value, found.unit, found.high) == (pytest.approx(2.1), "s", 2.0)
    assert found.sigma == pytest.approx(math.hypot(0.1, 2.1 * 0.1))
    (begin_s,) = found.begin_points
    assert begin_s == pytest.approx(2.0 - 0.8416 * math.hypot(0.1, 2.0 * 0.1), abs=1e-3)
    assert found.ends_at == "2.50 s"


def test_a_speed_that_is_not_known_gives_no_time():
    (found,) = of(TimeToContactCondition(below_s=2.0, target="ball"), track(0.5, closing_sigma_mps=2.0))
    assert (found.value, found.sigma, found.holds, found.begins_at) == (None, None, None, "")


def test_of_a_separation_it_is_told_what_is_not_counted():
    (found,) = of(separation(targets=("ball", "tag"), below=1.0), track(), track(3.4, target="tag"))
    assert (found.quantity, found.about) == ("separation", ("ball", "tag"))
    assert found.value == pytest.approx(1.3)
    assert found.sigma == pytest.approx(math.hypot(0.1, 0.1))
    assert found.words.endswith("how sure the directions are is not known, and not counted")


def test_what_is_out_of_sight_has_no_figures():
    (found,) = of(NEAR, track(status=TrackStatus.LOST, reason="no blob"))
    assert (found.value, found.probability, found.holds, found.begins_at) == (None, None, None, "")
    assert found.words == "ball is lost: no blob"


def test_other_conditions_tell_what_they_go_by():
    muted, night = RuleCondition(rule="mute"), ScheduleCondition(from_s=79200.0, to_s=21600.0)
    seen = PresenceCondition(seen=True, for_s=8.0, target="ball")
    condition = AnyOf(conditions=(muted, night, seen, CountCondition(at_least=2, targets=("ball",))))
    rule, time, presence, count = of(condition, active={"mute": True})
    assert (rule.quantity, rule.about, rule.holds) == ("rule", ("mute",), True)
    assert (time.quantity, time.about, time.holds) == ("time of day", (), None)
    assert (presence.quantity, presence.value, presence.low, presence.unit) == ("presence", 6.0, 8.0, "s")
    assert (count.quantity, count.value, count.low, count.holds) == ("count", 1.0, 2.0, False)


def test_there_is_one_for_each_part_judged_as_the_whole_judges_it():
    condition = AllOf(conditions=(NEAR, DistanceCondition(above=0.5, target="tag")))
    ball, tag = of(condition, track(2.1), track(0.45, target="tag"), is_active=True, held=(True, False))
    assert (ball.holds, tag.holds) == (True, False)
    assert ball.high > 2.0
    assert tag.low == 0.5


def test_below_a_not_the_whole_begins_where_the_part_ends():
    (plain,) = of(NEAR, track(1.95))
    (inverted,) = of(Not(condition=NEAR), track(1.95))
    assert (inverted.begins_at, inverted.ends_at) == (plain.ends_at, plain.begins_at)


@given(
    st.floats(0.3, 6),
    st.floats(0.001, 0.3),
    st.sampled_from([None, 0.5, 0.8, 0.95]),
    st.sampled_from(["above", "below"]),
    st.booleans(),
)
def test_the_condition_turns_exactly_where_it_is_said_to(distance_m, sigma_m, probability, side, is_on):
    limits = {"above": 2.0} if side == "above" else {"below": 2.0}
    condition = DistanceCondition(probability_on=probability, target="ball", **limits)
    (found,) = of(condition, track(distance_m, sigma_m))
    points = found.end_points if is_on else found.begin_points
    assume(points)
    # σ grows as the distance squared, so (d − 2 m)/σ is greatest at 4 m: a point there is touched, not passed.
    assume(abs(points[0] - 4.0) > 1e-3)
    step_m = 1e-6 if side == "below" else -1e-6

    def holds(at_m):
        there = track(at_m, sigma_m * (at_m / distance_m) ** 2)
        return judge(condition, inputs(there), (), is_active=is_on).value

    assert holds(points[0] - step_m) is True
    assert holds(points[0] + step_m) is False
