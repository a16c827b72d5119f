"""Alarms that latch, that somebody must acknowledge, that are reported again, and the first of a group."""

import pytest
from msgspec.structs import replace

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decision import RuleStatus, Severity
from support.near_alarm import CLOSE, FAR, NEAR, rehearse


def status(decision, rule="near"):
    return next(trace for trace in decision.rules if trace.rule == rule)


def level(decision):
    return decision.commands[0].level


def told(run):
    return [
        (event.kind.value, event.notify)
        for _, decision in run.decisions
        for event in decision.events
        if event.source == "near"
    ]


def test_a_latched_alarm_stands_until_somebody_resets_it():
    run = rehearse(latch=True)
    run.see(*FAR, *CLOSE)
    decision = run.see(*FAR, *FAR)
    assert status(decision).status is RuleStatus.LATCHED
    assert level(decision) == 1.0
    assert run.tell("reset", "near", why="looked at it").accepted
    assert level(run.see(3)) == 0.0
    assert run.events("near") == ["raised", "reset", "cleared"]
    reset = next(event for _, decision in run.decisions for event in decision.events if event.kind.value == "reset")
    assert (reset.by, reset.reason) == ("Ada", "by Ada: looked at it")


def test_a_reset_is_refused_while_the_condition_holds():
    run = rehearse(latch=True)
    run.see(*FAR, *CLOSE)
    answer = run.tell("reset", "near")
    assert (answer.accepted, answer.words) == (False, "near: its condition still holds")
    assert run.events("near") == ["raised", "refused"]
    assert level(run.see(*CLOSE)) == 1.0


def test_a_latched_alarm_that_holds_again_is_active_and_latches_again_without_a_new_event():
    run = rehearse(latch=True)
    run.see(*FAR, *CLOSE, *FAR, *FAR)
    assert status(run.see(*CLOSE)).status is RuleStatus.ACTIVE
    assert status(run.see(*FAR, *FAR)).status is RuleStatus.LATCHED
    assert run.events("near") == ["raised"]


def test_an_alarm_that_must_be_acknowledged_is_not_over_when_its_condition_is():
    run = rehearse(ack="required")
    run.see(*FAR, *CLOSE)
    trace = status(run.see(*FAR, *FAR))
    assert (trace.status, trace.acknowledged) == (RuleStatus.RETURNED, False)
    assert level(run.see(3)) == 0.0
    assert run.tell("acknowledge", "near").accepted
    trace = status(run.see(3))
    assert (trace.status, trace.acknowledged) == (RuleStatus.IDLE, True)


def test_an_acknowledged_alarm_goes_on_until_its_condition_ends():
    run = rehearse(ack="required")
    run.see(*FAR, *CLOSE)
    assert not status(run.see(0.5)).acknowledged
    assert run.tell("acknowledge", "near", by="Ben", why="on my way").accepted
    trace = status(run.see(0.5))
    assert (trace.status, trace.acknowledged) == (RuleStatus.ACTIVE, True)
    assert level(run.see(0.5)) == 1.0
    assert status(run.see(*FAR, *FAR)).status is RuleStatus.IDLE
    assert run.events("near") == ["raised", "acknowledged", "cleared"]


def test_there_is_nothing_to_acknowledge_twice():
    run = rehearse(ack="required")
    run.see(*FAR, *CLOSE)
    assert run.tell("acknowledge", "near").accepted
    assert run.tell("acknowledge", "near").words == "near: there is nothing to acknowledge"


def test_a_latched_alarm_is_acknowledged_before_it_is_reset():
    run = rehearse(latch=True, ack="required")
    run.see(*FAR, *CLOSE, *FAR, *FAR)
    assert run.tell("reset", "near").words == "near: it is not acknowledged; acknowledge it first"
    assert run.tell("acknowledge", "near").accepted
    assert run.tell("reset", "near").accepted
    assert status(run.see(3)).status is RuleStatus.IDLE


def test_a_latch_until_acknowledged_goes_on_after_its_condition_and_ends_when_it_is_acknowledged():
    run = rehearse(latch=True, ack_resets=True, ack="required")
    run.see(*FAR, *CLOSE, *FAR, *FAR)
    assert (status(run.see(3)).status, level(run.see(3))) == (RuleStatus.LATCHED, 1.0)
    assert run.tell("acknowledge", "near", by="Ben").accepted
    decision = run.see(3)
    assert (status(decision).status, level(decision)) == (RuleStatus.IDLE, 0.0)
    assert run.events("near") == ["raised", "acknowledged", "cleared"]


def test_a_latch_until_acknowledged_that_was_acknowledged_early_clears_with_its_condition():
    run = rehearse(latch=True, ack_resets=True, ack="required")
    run.see(*FAR, *CLOSE)
    assert run.tell("acknowledge", "near").accepted
    assert level(run.see(0.5)) == 1.0
    assert status(run.see(*FAR, *FAR)).status is RuleStatus.IDLE


def test_an_alarm_that_stands_long_is_reported_again_and_unacknowledged_again():
    run = rehearse(ack="required", realarm_s=1.0)
    run.see(*FAR, *CLOSE)
    run.tell("acknowledge", "near")
    run.see(*[0.5] * 12)
    assert run.events("near") == ["raised", "acknowledged", "realarmed"]
    assert not status(run.see(0.5)).acknowledged
    run.see(*[0.5] * 10)
    assert run.events("near").count("realarmed") == 2


def test_within_the_cooldown_an_alarm_acts_but_tells_nobody():
    run = rehearse(cooldown_s=60.0)
    run.see(*FAR, *CLOSE, *FAR, *FAR)
    assert level(run.see(*CLOSE)) == 1.0
    run.see(*FAR, *FAR)
    assert told(run) == [("raised", True), ("cleared", True), ("raised", False), ("cleared", False)]


def test_an_alarm_that_still_stands_when_the_cooldown_is_over_is_told_then():
    run = rehearse(cooldown_s=2.0)
    run.see(*FAR, *CLOSE, *FAR, *FAR)
    run.see(*[0.5] * 30)
    assert told(run) == [("raised", True), ("cleared", True), ("raised", False), ("realarmed", True)]
    run.see(*FAR, *FAR)
    assert told(run)[-1] == ("cleared", True)


def test_the_first_alarm_of_a_group_is_marked_until_all_have_cleared():
    second = replace(NEAR, name="nearer", output="lamp", condition=DistanceCondition(below=0.7))
    run = rehearse(NEAR, second, group="door")
    run.see(*FAR, 0.9, 0.9)
    decision = run.see(*CLOSE)
    assert [trace.first_out for trace in decision.rules] == [True, False]
    raised = [event for _, d in run.decisions for event in d.events if event.kind.value == "raised"]
    assert [(event.source, event.first_out) for event in raised] == [("near", True), ("nearer", False)]
    decision = run.see(*FAR, *FAR)
    assert [trace.first_out for trace in decision.rules] == [False, False]
    run.see(*CLOSE)
    assert run.events("nearer")[-1] == "raised"


def test_the_mark_stays_on_the_first_one_while_another_of_its_group_stands():
    gone = replace(NEAR, name="gone", output=None, condition=PresenceCondition(seen=False))
    run = rehearse(replace(gone, severity=Severity.SAFETY), replace(NEAR, latch=True), group="door")
    run.see(None, None, 3, 3, *CLOSE)
    assert run.events("gone") == ["raised", "cleared"]
    assert run.events("near") == ["raised"]
    decision = run.see(*FAR, *FAR)
    assert status(decision, "near").status is RuleStatus.LATCHED
    assert [trace.first_out for trace in decision.rules] in ([True, False], [False, True])
    assert sum(trace.first_out for trace in decision.rules) == 1


def test_a_rule_that_is_only_observed_is_judged_and_moves_nothing():
    run = rehearse(observe=True)
    decision = run.see(*FAR, *CLOSE)
    assert level(decision) == 0.0
    assert status(decision).inhibits == ("observed",)
    assert told(run) == [("raised", False)]


@pytest.mark.parametrize("seconds", [1.0, 8 * 3600.0])
def test_a_shelved_alarm_is_quiet_and_speaks_when_the_time_is_over(seconds):
    run = rehearse()
    run.see(*FAR)
    assert run.tell("shelve", "near", for_s=seconds, why="painting").accepted
    decision = run.see(*CLOSE)
    assert (level(decision), status(decision).inhibits) == (0.0, ("shelved",))
    assert told(run) == [("shelved", False), ("raised", False)]
    run.now_s += seconds
    decision = run.see(0.5, 0.5, 0.5)
    assert (level(decision), status(decision).inhibits) == (1.0, ())
    assert told(run)[2:] == [("unshelved", False), ("realarmed", True)]


def test_only_unshelving_ends_a_shelf_sooner():
    run = rehearse()
    run.see(*FAR, *CLOSE)
    assert run.tell("shelve", "near", for_s=600).accepted
    for shorter in ({"for_s": 30}, {"for_s": 3600, "one_shot": True}):
        assert run.tell("shelve", "near", **shorter).words.startswith("near: it is shelved for another 10")
    assert run.tell("shelve", "near", for_s=900).accepted
    assert level(run.see(0.5)) == 0.0
    assert run.tell("unshelve", "near").accepted
    assert level(run.see(0.5)) == 1.0


def test_one_shot_shelving_ends_when_the_alarm_has_returned_to_normal():
    run = rehearse()
    run.see(*FAR, *CLOSE)
    assert run.tell("shelve", "near", for_s=600, one_shot=True).accepted
    assert level(run.see(0.5)) == 0.0
    run.see(*FAR, *FAR)
    assert run.events("near") == ["raised", "shelved", "cleared", "unshelved"]
    assert level(run.see(*CLOSE)) == 1.0


@pytest.mark.parametrize(
    ("fields", "asked_s", "words"),
    [
        ({"severity": Severity.SAFETY}, 60, "near: a safety rule cannot be kept quiet"),
        ({"shelve_max_s": 0.0}, 60, "near: its configuration does not let it be shelved (shelve_max)"),
        ({"shelve_max_s": 60.0}, 61, "near: 61 s is not a time above zero and up to 1 min, the longest for 'near'"),
        ({}, float("nan"), "near: nan s is not a time above zero and up to 8 h, the longest for 'near'"),
        ({}, -1, "near: -1 s is not a time above zero and up to 8 h, the longest for 'near'"),
    ],
)
def test_shelving_that_is_not_allowed_is_refused_with_the_reason(fields, asked_s, words):
    run = rehearse(**fields)
    run.see(*FAR)
    answer = run.tell("shelve", "near", for_s=asked_s)
    assert (answer.accepted, answer.words) == (False, words)
    assert level(run.see(*CLOSE)) == 1.0


def test_out_of_service_lasts_until_it_is_put_back():
    run = rehearse()
    run.see(*FAR)
    assert run.tell("take-out", "near").accepted
    assert level(run.see(*CLOSE)) == 0.0
    assert run.tell("take-out", "near").words == "near: it is out of service already"
    assert run.tell("put-back", "near").accepted
    assert level(run.see(0.5)) == 1.0


def test_who_shelves_is_told_for_how_long():
    run = rehearse()
    run.see(*FAR)
    assert run.tell("shelve", "near", for_s=1800.0).words == "shelve: near for 30 min"
    assert run.tell("unshelve", "near").words == "unshelve: near"
    assert run.tell("shelve").words == "shelve: near for 8 h"


def test_a_safety_rule_cannot_be_taken_out():
    run = rehearse(severity=Severity.SAFETY)
    run.see(*FAR)
    assert not run.tell("take-out", "near").accepted


def test_a_command_to_a_rule_that_is_not_there_names_those_that_are():
    answer = rehearse().tell("acknowledge", "neer")
    assert answer.words == "there is no alarm 'neer'; there are: near"


def test_a_command_to_all_reaches_those_that_it_is_meant_for():
    other = replace(NEAR, name="other", output="lamp", condition=DistanceCondition(below=0.1))
    run = rehearse(NEAR, other, ack="required")
    run.see(*FAR, *CLOSE)
    assert run.tell("acknowledge").words == "acknowledge: near"
    assert run.tell("acknowledge").words == "acknowledge: no alarm needs it"
