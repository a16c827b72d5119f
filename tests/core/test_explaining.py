"""What is said of a rule: also of what did not happen, and what it would have taken."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.conditions.compounds import AllOf, Not
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import RuleStatus, SafetyMode
from stadimeter.core.observation import Observation
from stadimeter.core.plan import LevelOutput, Tracking
from stadimeter.core.rule import AlarmRule, FollowRule, OnDelay, RampRule
from stadimeter.core.rules.explaining import explain
from support import near_alarm
from support.conditions import direction
from support.observing import Rehearsal

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
    assert (found.winner, found.losers) == ("nearer", ("near",))


def test_a_rule_that_lost_to_an_equal_says_that_another_level_counts():
    other = replace(NEAR, name="louder", level=0.9)
    decision = rehearse(replace(NEAR, level=0.2), other).see(3.0, *[1.0] * 5)
    assert said(decision).endswith("but 'louder' commands 'buzzer', with the same priority and the level that counts")


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


def test_within_the_cooldown_it_says_when_people_are_told():
    run = rehearse(cooldown_s=60.0, off_delay_s=0.2)
    run.see(3.0, *[1.0] * 5, *[3.0] * 5)
    assert "no notification for another 5" in said(run.see(*[1.0] * 5))


def test_a_condition_with_parts_shows_each_with_its_own_verdict():
    parts = AllOf(conditions=(DistanceCondition(below=2.0), Not(condition=direction(above=0.1))))
    run = rehearse(condition=parts)
    found = explain(run.see(*[1.0] * 5, bearing_rad=0.3), "near")
    assert found.status is RuleStatus.IDLE
    assert [each.holds for each in found.evidence] == [True, True]
    assert [each.quantity for each in found.evidence] == ["distance", "bearing"]


def test_ramps_and_follow_rules_are_explained_too():
    run = rehearse(
        RampRule(name="ramp", target="ball", output="buzzer", start=2.0, full=1.0),
        FollowRule(name="follow", target="ball", distance_m=1.0),
    )
    decision = run.see(*[1.5] * 5)
    assert said(decision, "ramp").startswith("active: 1.5")
    assert said(decision, "ramp").endswith("it commands 'buzzer'")
    assert said(decision, "follow")


def test_a_decision_that_was_read_from_a_file_has_no_reasons():
    decision = replace(rehearse().see(1.0), reasons={})
    with pytest.raises(TypeError, match="decide again"):
        explain(decision, "near")


def test_a_target_that_was_found_to_be_noisier_than_stated_is_said_to_be():
    run = rehearse()
    errors_m = np.random.default_rng(3).normal(size=60)
    assert "times as noisy" not in said(run.see(*[2.5 + 0.002 * each for each in errors_m], sigma_m=0.002))
    noisy = Rehearsal(replace(run.state.plan, tracking=Tracking()))
    assert "times as noisy as its measurements state" in said(
        noisy.see(*[2.5 + 0.05 * each for each in errors_m], sigma_m=0.01)
    )
