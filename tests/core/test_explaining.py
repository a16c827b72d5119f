"""What is said of a rule: also of what did not happen, the figures behind it, and where it would turn."""

import math
import re

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
from stadimeter.core.decision import RuleStatus, SafetyMode
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.observation import Observation
from stadimeter.core.plan import LevelOutput
from stadimeter.core.rule import AlarmRule, OnDelay
from stadimeter.core.rules.explaining import explain
from support import near_alarm
from support.conditions import direction, separation

# What is said of a rule: also of what did not happen, and what it would have taken.

NEAR = AlarmRule(
    name="near",
    target="ball",
    output="buzzer",
    condition=DistanceCondition(below=2.0, probability_on=0.8),
    off_delay_s=1.0,
    cooldown_s=0,
)


def rehearse(*rules, **fields):
    return near_alarm.rehearse(*(rules or (NEAR,)), outputs=(LevelOutput(name="buzzer"),), **fields)


def said(decision, rule="near"):
    return explain(decision, rule).sentence


def test_a_rule_that_was_not_raised_says_how_likely_it_was_and_what_it_would_have_taken():
    run = rehearse()
    decision = run.see(*[2.02] * 20, sigma_m=0.05)
    found = explain(decision, "near")
    assert found.status is RuleStatus.IDLE
    assert found.sentence.startswith("not raised: 2.0")
    assert "begins at 0.80" in found.sentence
    (figures,) = found.evidence
    assert figures.probability < 0.8
    (begins_at_m,) = figures.begin_points
    assert found.sentence.endswith(f"; would raise at {begins_at_m:.2f} m")
    for_views = explain(decision, "near", with_probability=False).sentence
    assert for_views == re.sub(r": P [\d.]+, begins at 0\.80", "", found.sentence)
    assert 1.8 < begins_at_m < 2.0


def test_it_is_true_that_the_rule_would_raise_there():
    run = rehearse()
    (figures,) = explain(run.see(*[2.1] * 30, sigma_m=0.02), "near").evidence
    (begins_at_m,) = figures.begin_points
    run.see(*[begins_at_m + 0.01] * 60, sigma_m=0.02)
    assert run.events("near") == []
    run.see(*[begins_at_m - 0.01] * 60, sigma_m=0.02)
    assert run.events("near") == ["raised"]


def test_a_rule_that_waits_says_for_how_long():
    run = rehearse(on_delay=OnDelay(hold_s=1.0))
    run.see(*[3.0] * 3)
    assert "held for 0.5 s of the 1.0 s that it takes" in said(run.see(*[1.0] * 6))
    run = rehearse(on_delay=OnDelay(frames=3, of_frames=5))
    assert "held in 2 of the newest 5 frames; it takes 3" in said(run.see(3.0, 1.0, 1.0))


def test_an_active_rule_says_since_when_what_it_drives_and_what_would_clear_it():
    run = rehearse()
    sentence = said(run.see(3.0, *[1.0] * 5))
    assert sentence.startswith("raised 0.4 s ago: 1.0")
    assert "would clear at 2.1" in sentence
    assert sentence.endswith("it commands 'buzzer'")


def test_a_rule_that_is_clearing_says_how_far_it_is():
    run = rehearse()
    run.see(3.0, *[1.0] * 5)
    assert "ended for 0.2 s of the 1.0 s that it takes" in said(run.see(3.0, 3.0, 3.0))


def test_a_rule_says_at_which_figure_its_verdict_would_change_and_never_one_that_it_has_passed():
    run = rehearse(replace(NEAR, latch=True))
    assert "would clear at 2.1" in said(run.see(3.0, *[1.0] * 5))
    for frames in (3, 20):  # clearing, and latched
        past = said(run.see(*[3.0] * frames))
        assert "would hold again at 2.0" in past
        assert "would clear" not in past
    run = rehearse(replace(NEAR, ack="required", on_delay=OnDelay(hold_s=5.0), off_delay_s=0.0))
    run.see(*[1.0] * 60, *[3.0] * 5)
    assert "would raise" not in said(run.see(*[1.0] * 10)), "over, not acknowledged, and on its way to be raised again"


def test_a_rule_without_its_target_says_so_and_what_it_does_meanwhile():
    run = rehearse()
    run.see(3.0, *[1.0] * 5)
    sentence = said(run.see(*[None] * 10))
    assert sentence.startswith("held as it was, raised, since there is nothing to judge by for ")
    assert "ball is lost: " in sentence
    run = rehearse()
    assert said(run.see(None)).startswith("not raised, since there is nothing to judge by for 0.0 s: ball is searching")


def test_a_rule_that_lost_its_output_says_to_whom():
    other = replace(NEAR, name="nearer", priority=200, condition=DistanceCondition(below=1.5))
    run = rehearse(NEAR, other)
    decision = run.see(3.0, *[1.0] * 5)
    assert said(decision).endswith("but 'nearer' commands 'buzzer', with a higher priority than 100")
    found = explain(decision, "nearer")
    assert found.sentence.endswith("it commands 'buzzer', before near")


def test_a_rule_that_safety_holds_back_says_why():
    run = rehearse()
    run.see(3.0, *[1.0] * 5)
    run.wait(0.25)
    decision = run.cycle(Observation(now_s=run.now_s + 0.01))
    assert decision.safety is SafetyMode.STALE
    assert "but 'buzzer' is kept safe: the newest frame is" in said(decision)


@pytest.mark.parametrize(
    ("action", "words"),
    [("shelve", "kept quiet: shelved by Ada for another 8 h"), ("take-out", "kept quiet: out of service")],
)
def test_a_rule_that_is_kept_quiet_says_by_what(action, words):
    run = rehearse()
    run.see(3.0, *[1.0] * 5)
    run.tell(action, "near")
    sentence = said(run.see(1.0))
    assert words in sentence.replace("8.0 h", "480 min")
    assert "commands" not in sentence


def test_a_latched_rule_says_what_ends_it():
    run = rehearse(latch=True, ack="required")
    run.see(3.0, *[1.0] * 5)
    assert said(run.see(1.0)).startswith("raised 0.5 s ago, not acknowledged: ")
    assert said(run.see(*[3.0] * 15)).startswith("raised 2.0 s ago, latched until it is acknowledged and reset: ")
    run.tell("acknowledge", "near")
    assert said(run.see(3.0)).startswith("raised 2.1 s ago, latched until it is reset: ")


def test_a_decision_that_was_read_from_a_file_has_no_reasons():
    decision = replace(rehearse().see(1.0), reasons={})
    with pytest.raises(TypeError, match="decide again"):
        explain(decision, "near")


# The figures behind a condition, and where it would turn.

NEAR_CONDITION = DistanceCondition(
    below=2.0, probability_on=0.8, probability_off=0.5, deadband_sigmas=3.0, target="ball"
)


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
    (found,) = of(NEAR_CONDITION, track(1.95))
    assert (found.quantity, found.about, found.unit) == ("distance", ("ball",), "m")
    assert (found.value, found.sigma, found.low, found.high) == (1.95, 0.1, None, 2.0)
    assert found.probability == pytest.approx(0.691, abs=1e-3)
    assert found.holds is False
    assert found.words == "ball 1.95 m ± 0.10, below 2.00 m: P 0.69, begins at 0.80"


def test_a_standard_deviation_that_grows_with_distance_is_counted_as_it_will_be_there():
    (far,) = of(NEAR_CONDITION, track(4.0, 0.4))
    (there,) = of(NEAR_CONDITION, track(2.0, 0.1))
    assert far.begin_points == pytest.approx(there.begin_points)


def test_while_it_holds_the_deadband_is_in_the_limit():
    (found,) = of(NEAR_CONDITION, track(2.1), is_active=True)
    assert found.holds is True
    assert found.high == pytest.approx(2.0 + 3 * 0.1 * (2.0 / 2.1) ** 2)


def test_an_angle_is_told_in_degrees_and_nothing_is_claimed_of_how_sure_it_is():
    (found,) = of(direction(above=math.radians(20), deadband=math.radians(2), target="ball"))
    assert (found.quantity, found.unit, found.sigma, found.probability) == ("bearing", "rad", None, None)
    assert (found.begins_at, found.ends_at) == ("20.0°", "18.0°")
    assert found.words.endswith("how sure a direction is, is not known")


def test_a_time_to_contact_comes_with_the_standard_deviation_of_the_ratio():
    soon = TimeToContactCondition(below_s=2.0, probability_on=0.8, deadband_sigmas=0.0, target="ball")
    (found,) = of(soon)
    assert (found.value, found.unit, found.high) == (pytest.approx(2.1), "s", 2.0)
    assert found.sigma == pytest.approx(math.hypot(0.1, 2.1 * 0.1))
    (begin_s,) = found.begin_points
    assert begin_s == pytest.approx(2.0 - 0.8416 * math.hypot(0.1, 2.0 * 0.1), abs=1e-3)
    assert found.ends_at == "2.50 s"


def test_of_a_separation_it_is_told_what_is_not_counted():
    (found,) = of(separation(targets=("ball", "tag"), below=1.0), track(), track(3.4, target="tag"))
    assert (found.quantity, found.about) == ("separation", ("ball", "tag"))
    assert found.value == pytest.approx(1.3)
    assert found.sigma == pytest.approx(math.hypot(0.1, 0.1))
    assert found.words.endswith("how sure the directions are is not known, and not counted")


def test_what_is_out_of_sight_has_no_figures():
    (found,) = of(NEAR_CONDITION, track(status=TrackStatus.LOST, reason="no blob"))
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
    condition = AllOf(conditions=(NEAR_CONDITION, DistanceCondition(above=0.5, target="tag")))
    ball, tag = of(condition, track(2.1), track(0.45, target="tag"), is_active=True, held=(True, False))
    assert (ball.holds, tag.holds) == (True, False)
    assert ball.high > 2.0
    assert tag.low == 0.5


def test_below_a_not_the_whole_begins_where_the_part_ends():
    (plain,) = of(NEAR_CONDITION, track(1.95))
    (inverted,) = of(Not(condition=NEAR_CONDITION), track(1.95))
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
