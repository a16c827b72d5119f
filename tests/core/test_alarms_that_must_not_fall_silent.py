"""Ways in which an alarm could be missed, fall silent, stand for ever or come too often."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.conditions.compounds import AllOf, Not
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decision import RuleStatus, Severity
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.rule import AlarmRule, Lost, LostPolicy, OnDelay
from stadimeter.core.rules.explaining import explain
from support.each_case import each_case
from support.near_alarm import CLOSE, FAR, NEAR, rehearse
from support.observing import measured

GONE = AlarmRule(name="gone", target="ball", condition=PresenceCondition(seen=False), cooldown_s=0)
ASKS = AlarmRule(name="asks", target="ball", output="lamp", condition=RuleCondition(rule="near"), off_delay_s=0.0)


def trace(run, rule="near"):
    return next(trace for trace in run.decisions[-1][1].rules if trace.rule == rule)


def events(run, rule="near"):
    return [event for _, decision in run.decisions for event in decision.events if event.source == rule]


def told(run, rule="near"):
    return [event.kind.value for event in events(run, rule) if event.notify]


# An outlier just before a loss.


@pytest.mark.parametrize("for_s", [0.0, 1.0])
def test_an_outlier_just_before_a_loss_does_not_keep_the_loss_from_being_raised(for_s):
    run = rehearse(replace(GONE, condition=PresenceCondition(seen=False, for_s=for_s)), outliers_max=3)
    run.see(*[2.0] * 20, 4.5, *[None] * 30)
    assert run.events("gone") == ["raised"]


def test_an_outlier_just_before_a_loss_leaves_no_refused_measurement_in_the_track():
    run = rehearse(outliers_max=3)
    run.see(*[2.0] * 20, 4.5, *[None] * 10)
    (track,) = run.decisions[-1][1].tracks
    assert (track.status.value, track.rejected) == ("lost", 0)


# Latched and out of sight.


def test_an_alarm_that_latches_stands_until_it_is_reset_though_its_target_left_while_it_held():
    run = rehearse(latch=True, lost=Lost(grace_s=0.2, fault_after_s=1.0))
    run.see(*FAR, *CLOSE, *[None] * 5)
    refused = run.tell("reset", "near")
    assert not refused.accepted
    assert "fault_after" in refused.words
    run.see(*[None] * 15)
    assert trace(run).status is RuleStatus.LATCHED
    assert run.decisions[-1][1].commands[0].level == 1.0
    assert run.events("near") == ["raised", "refused", "measurement_lost"]
    assert run.tell("reset", "near").accepted
    assert run.events("near")[-2:] == ["reset", "cleared"]


def test_a_latched_alarm_whose_target_comes_back_inside_is_active_again():
    run = rehearse(latch=True, lost=Lost(grace_s=0.2, fault_after_s=1.0))
    run.see(*FAR, *CLOSE, *[None] * 20, 0.5, 0.5)
    assert trace(run).status is RuleStatus.ACTIVE
    assert run.events("near") == ["raised", "measurement_lost", "measurement_back"]
    assert not run.tell("reset", "near").accepted


# One-shot shelving.


@pytest.mark.parametrize("how", ["acknowledged", "reset"])
def test_a_one_shot_shelf_ends_with_the_return_to_normal_however_that_comes(how):
    run = rehearse(ack="required" if how == "acknowledged" else "none", latch=how == "reset")
    run.see(*FAR, *CLOSE)
    assert run.tell("shelve", "near", for_s=600, one_shot=True).accepted
    run.see(*FAR, *FAR)
    assert "unshelved" not in run.events("near")
    assert run.tell("acknowledge" if how == "acknowledged" else "reset", "near").accepted
    run.see(3.0)
    assert run.events("near")[-1] == "unshelved"
    assert trace(run).inhibits == ()
    run.see(*CLOSE)
    assert told(run)[-1] == "raised"


# Whether an alarm is active: one answer.


@each_case(
    ("fields", "before", "expected"),
    [
        ({}, 0.5, True),
        ({}, 3.0, None),
        ({"latch": True}, 0.5, True),
        ({"lost": Lost(policy=LostPolicy.CLEAR)}, 0.5, False),
        ({"lost": Lost(policy=LostPolicy.CLEAR)}, 3.0, False),
        ({"lost": Lost(policy=LostPolicy.ASSERT)}, 3.0, True),
        ({"lost": Lost(policy=LostPolicy.ASSERT)}, 0.5, True),
        ({"ack": "required", "lost": Lost(policy=LostPolicy.CLEAR)}, 0.5, False),
    ],
)
def test_whether_an_alarm_is_active_is_known_out_of_sight_where_it_stands_or_its_policy_decides(
    fields, before, expected
):
    run = rehearse(replace(NEAR, **fields), ASKS)
    run.see(*FAR, before, before, before, *[None] * 80)
    assert trace(run).active is expected
    assert run.state.rules.active["near"] is expected
    assert trace(run, "asks").active is expected


def test_a_rule_that_depends_on_a_latched_alarm_does_not_let_go_when_the_target_is_lost():
    run = rehearse(replace(NEAR, latch=True), ASKS)
    run.see(*FAR, *CLOSE, *FAR)
    assert run.decisions[-1][1].commands[1].level == 1.0
    run.see(*[None] * 80)
    assert run.decisions[-1][1].commands[1].level == 1.0
    assert run.events("asks") == ["raised"]


def test_suppression_by_an_alarm_that_stands_out_of_sight_goes_on():
    quiet = replace(GONE, suppress_when=RuleCondition(rule="near"))
    run = rehearse(NEAR, quiet)
    run.see(*FAR, *CLOSE, *[None] * 10)
    assert trace(run, "gone").inhibits == ("suppressed",)
    run.see(*[None] * 80)
    assert trace(run, "gone").inhibits == ("suppressed",)


# What a target that leaves does to an alarm.


def test_a_light_while_the_target_is_near_and_30_s_after_goes_off_30_s_after_it_left():
    run = rehearse(lost=Lost(policy=LostPolicy.CLEAR), off_delay_s=30.0)
    run.see(*FAR, *CLOSE)
    left_s = run.now_s
    run.see(*[None] * 295)
    assert run.decisions[-1][1].commands[0].level == 1.0
    assert trace(run).status is RuleStatus.CLEARING
    run.see(*[None] * 20)
    assert run.events("near") == ["raised", "cleared"]
    (cleared,) = [event for event in events(run) if event.kind.value == "cleared"]
    assert cleared.at_s - left_s == pytest.approx(30.0 + 0.5 + 0.2, abs=0.15)
    assert run.decisions[-1][1].commands[0].level == 0.0


def test_time_in_which_the_program_stood_still_counts_for_no_off_delay_out_of_sight():
    run = rehearse(lost=Lost(policy=LostPolicy.CLEAR), off_delay_s=30.0)
    run.see(*FAR, *CLOSE, *[None] * 10)
    run.now_s += 60.0
    run.see(*[None] * 250)
    assert run.events("near") == ["raised"]


@pytest.mark.parametrize(
    ("policy", "words"), [(LostPolicy.CLEAR, "counts as over"), (LostPolicy.ASSERT, "counts as danger")]
)
def test_what_a_policy_decided_is_said_as_a_decision_and_not_as_something_unknown(policy, words):
    run = rehearse(lost=Lost(policy=policy), off_delay_s=0.0)
    run.see(*FAR, *CLOSE, *[None] * 20)
    assert trace(run).status is (RuleStatus.IDLE if policy is LostPolicy.CLEAR else RuleStatus.ACTIVE)
    decision = run.decisions[-1][1]
    for sentence in (decision.reasons["near"], explain(decision, "near").sentence):
        assert words in sentence
        assert "held" not in sentence.split(":")[0]


# How often people are notified.


def test_a_re_alarm_obeys_the_cooldown():
    run = rehearse(realarm_s=5.0, cooldown_s=12.0)
    run.see(*FAR, *[0.5] * 300)
    times_s = [event.at_s for event in events(run) if event.notify]
    assert [event.kind.value for event in events(run)].count("realarmed") == 5
    assert len(times_s) == 2
    assert all(later - earlier >= 12.0 for earlier, later in pairwise(times_s))


def test_times_of_zero_are_times():
    run = rehearse(realarm_s=1.0, at_start="act")
    run.now_s = -0.1
    run.see(*[0.5] * 15)
    assert events(run)[0].at_s == 0.0
    assert run.events("near") == ["raised", "realarmed"]
    run = rehearse(lost=Lost(grace_s=0.5, policy=LostPolicy.ASSERT))
    run.now_s = -0.1
    run.see(*[None] * 8)
    assert "for 0.5 s" in events(run)[0].reason


def test_events_are_in_the_order_of_their_times():
    run = rehearse(replace(NEAR, latch=True), GONE, on_delay=OnDelay())
    for number, distance_m in enumerate([*FAR, *CLOSE, *FAR, *CLOSE, *FAR]):
        at_s = 0.1 * number
        stamp = FrameStamp(sequence=number, captured_at_s=at_s - 0.06)
        seen = measured("ball", at_s - 0.06, distance_m)
        run.now_s = at_s
        run.cycle(Observation(now_s=at_s, frame=stamp, measurements=(seen,)))
        if number in {9, 13}:
            run.tell("shelve" if number == 9 else "unshelve", "near")
    times_s = [event.at_s for _, decision in run.decisions for event in decision.events]
    assert times_s == sorted(times_s)
    for at_s, decision in run.decisions:
        assert all(event.at_s == at_s for event in decision.events)


# At the start.


def test_a_target_that_is_there_when_the_program_starts_raises_no_loss():
    run = rehearse(GONE, on_delay=OnDelay())
    run.see(None, None, None, None, *FAR)
    assert run.events("gone") == []


def test_a_target_that_nobody_ever_saw_is_lost_after_ten_seconds():
    run = rehearse(GONE, on_delay=OnDelay())
    run.see(*[None] * 99)
    assert run.events("gone") == []
    run.see(*[None] * 5)
    assert run.events("gone") == ["raised"]


def test_a_rule_for_safety_waits_for_nobody():
    run = rehearse(GONE, on_delay=OnDelay(), severity=Severity.SAFETY)
    run.see(None)
    assert run.events("gone") == ["raised"]


# Chattering.

CHATTER = [3.0] * 4 + [0.5] * 2


def test_a_chattering_alarm_stays_raised_and_is_reported_once():
    run = rehearse(raises_per_min_max=4)
    run.see(*CHATTER * 30)
    assert run.events("near").count("raised") == 4
    assert run.events("near").count("cleared") == 3
    assert run.events("near")[-1] == "chattering"
    assert told(run).count("chattering") == 1
    assert (trace(run).active, trace(run).chattering) == (True, True)
    run.see(*FAR)
    assert run.decisions[-1][1].commands[0].level == 1.0


def test_a_chattering_alarm_is_an_ordinary_one_again_when_it_has_calmed_down():
    run = rehearse(raises_per_min_max=4)
    run.see(*CHATTER * 10, *[3.0] * 610)
    assert run.events("near")[-3:] == ["chattering", "calmed", "cleared"]
    assert (trace(run).active, trace(run).chattering) == (False, False)
    run.see(*CLOSE)
    assert run.events("near")[-1] == "raised"


def test_a_chattering_alarm_that_goes_on_is_reported_no_second_time():
    run = rehearse(raises_per_min_max=4)
    run.see(*CHATTER * 120)
    assert run.events("near").count("chattering") == 1
    assert "calmed" not in run.events("near")


@settings(max_examples=25)
@given(st.lists(st.tuples(st.booleans(), st.integers(1, 60)), max_size=80), st.integers(1, 6), st.floats(0.0, 2.0))
def test_no_alarm_is_raised_more_often_in_a_minute_than_it_may_nor_unseen_while_it_holds(ways, most, off_delay_s):
    run = rehearse(raises_per_min_max=most, off_delay_s=off_delay_s)
    for is_close, frames in ways:
        run.see(*[0.5 if is_close else 3.0] * frames)
        assert trace(run).active or not is_close
    raised_s = [event.at_s for event in events(run) if event.kind.value == "raised"]
    assert all(later - earlier >= 60.0 - 1e-6 for earlier, later in zip(raised_s, raised_s[most:], strict=False))


# Rules that rest.


def test_an_alarm_that_its_policy_cleared_is_judged_anew_by_what_begins_it():
    either = AllOf(conditions=(DistanceCondition(below=1.0), Not(condition=RuleCondition(rule="other"))))
    other = replace(NEAR, name="other", output=None, condition=DistanceCondition(below=0.3))
    run = rehearse(replace(NEAR, condition=either, lost=Lost(policy=LostPolicy.CLEAR), off_delay_s=0.0), other)
    run.see(*FAR, *CLOSE, *[None] * 20, *CLOSE)
    assert run.events("near") == ["raised", "cleared", "raised"]
