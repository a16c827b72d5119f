"""Alarms: when they are raised and cleared, latch and are acknowledged, and what they do without their target."""

import pytest
from msgspec.structs import replace

from stadimeter.core.alarms.machine import ACTIVE, LATCHED, TO_ACKNOWLEDGE, AlarmRecord, AlarmState, Trigger, fire
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decision import RuleStatus, Severity
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, Lost, LostPolicy, OnDelay
from support.each_case import each_case
from support.near_alarm import CLOSE, FAR, NEAR, rehearse
from support.observing import Rehearsal

# Alarms: when they are raised and cleared, and what they do without their target.

NEAR_WITH_GRACE = AlarmRule(
    name="near",
    target="ball",
    output="buzzer",
    condition=DistanceCondition(below=1.0),
    off_delay_s=0.5,
    lost=Lost(grace_s=0.5, fault_after_s=5.0),
)
TRACKING = Tracking(confirm_frames=1, coast_s=0.15, outliers_max=0, acceleration_mps2=10.0, autocorrelation=0.0)


def rehearse_alarm(rule=NEAR_WITH_GRACE, frame_s=0.1):
    plan = Plan(
        targets=("ball",),
        rules=(rule,),
        outputs=(LevelOutput(name="buzzer"), BaseOutput(name="base")),
        tracking=TRACKING,
        safety=Safety(good_frames=1),
    )
    return Rehearsal(plan, frame_s)


def level(decision):
    return decision.commands[0].level


def test_an_approach_raises_it_once_and_leaving_clears_it_once():
    run = rehearse_alarm()
    run.see(3, 2.5, 2, 1.5, 0.8, 0.7, 0.8)
    assert run.events("near") == ["raised"]
    assert level(run.see(0.8)) == 1.0
    run.see(1.5, 2, 2.5, 3, 3, 3, 3)
    assert run.events("near") == ["raised", "cleared"]
    assert level(run.see(3)) == 0.0


def test_at_the_start_it_may_be_announced_without_moving_the_output():
    run = rehearse_alarm(replace(NEAR_WITH_GRACE, at_start="announce"))
    assert level(run.see(0.8, 0.7, 0.7)) == 0.0
    assert run.events("near") == ["raised"]
    run.see(3, 3, 3, 3, 3, 3, 3)
    assert level(run.see(0.8, 0.7)) == 1.0


def test_while_held_without_its_target_it_keeps_acting_for_a_while_and_then_gives_up():
    run = rehearse_alarm()
    run.see(3, 0.8, 0.8)
    assert level(run.see(*[None] * 40)) == 1.0
    assert level(run.see(*[None] * 20)) == 0.0
    assert run.events("near") == ["raised", "measurement_lost"]
    assert level(run.see(0.8)) == 1.0
    assert run.events("near") == ["raised", "measurement_lost", "measurement_back"]


def test_a_delay_stands_still_while_the_target_is_out_of_sight():
    run = rehearse_alarm(replace(NEAR_WITH_GRACE, on_delay=OnDelay(hold_s=0.5)))
    run.see(3, 0.8, 0.8, 0.8, *[None] * 4, 0.8, 0.8)
    assert run.events("near") == []
    assert run.decisions[-1][1].rules[0].status is RuleStatus.PENDING
    run.see(0.8)
    assert run.events("near") == ["raised"]


@each_case(
    ("policy", "before", "expected"),
    [
        (LostPolicy.HOLD, 0.8, ["raised"]),
        (LostPolicy.HOLD, 3.0, []),
        (LostPolicy.CLEAR, 0.8, ["raised", "cleared"]),
        (LostPolicy.CLEAR, 3.0, []),
        (LostPolicy.ASSERT, 0.8, ["raised"]),
        (LostPolicy.ASSERT, 3.0, ["raised"]),
    ],
)
def test_after_the_grace_the_policy_decides(policy, before, expected):
    run = rehearse_alarm(replace(NEAR_WITH_GRACE, lost=Lost(grace_s=0.5, policy=policy)))
    run.see(before, before, before, *[None] * 4)
    assert run.events("near") == expected[: 1 if before < 1 else 0]
    run.see(*[None] * 12)
    assert run.events("near") == expected


def test_cannot_see_counts_as_danger_from_the_start_where_asked_for():
    run = rehearse_alarm(replace(NEAR_WITH_GRACE, lost=Lost(grace_s=0.5, policy=LostPolicy.ASSERT)))
    assert level(run.see(*[None] * 8)) == 1.0


def test_timers_run_on_capture_time_and_not_on_the_number_of_frames():
    fast, slow = (
        rehearse_alarm(replace(NEAR_WITH_GRACE, on_delay=OnDelay(hold_s=1.0)), 0.01),
        rehearse_alarm(replace(NEAR_WITH_GRACE, on_delay=OnDelay(hold_s=1.0)), 0.25),
    )
    fast.see(3, *[0.8] * 100)
    slow.see(3, *[0.8] * 4)
    assert fast.events("near") == slow.events("near") == []
    fast.see(0.8, 0.8)
    slow.see(0.8)
    assert fast.events("near") == slow.events("near") == ["raised"]


def test_an_alarm_that_drives_a_base_stops_it():
    run = rehearse_alarm(replace(NEAR_WITH_GRACE, output="base"))
    decision = run.see(3, 0.8, 0.8)
    assert decision.outputs[1].winner == "near"
    assert (decision.commands[1].linear_mps, decision.commands[1].angular_radps) == (0.0, 0.0)
    assert decision.reasons["near"] == "0.800 m ± 0.010, below 1.05 m"


def test_being_seen_and_being_lost_are_conditions_too():
    lost = rehearse_alarm(replace(NEAR_WITH_GRACE, name="gone", condition=PresenceCondition(seen=False)))
    lost.see(2, 2, *[None] * 5)
    assert lost.events("gone") == ["raised"]
    seen = rehearse_alarm(replace(NEAR_WITH_GRACE, name="there", condition=PresenceCondition(seen=True)))
    seen.see(None, None, 2)
    assert seen.events("there") == ["raised"]


def test_a_delay_is_forgotten_when_the_target_was_away_for_longer_than_the_grace():
    run = rehearse_alarm(replace(NEAR_WITH_GRACE, on_delay=OnDelay(hold_s=0.5)))
    run.see(3, 0.8, 0.8, 0.8, 0.8, *[None] * 12, 0.8, 0.8, 0.8, 0.8)
    assert run.events("near") == []


def test_an_alarm_that_was_only_announced_acts_when_the_target_is_lost_and_that_means_danger():
    run = rehearse_alarm(
        replace(NEAR_WITH_GRACE, at_start="announce", lost=Lost(grace_s=0.3, policy=LostPolicy.ASSERT))
    )
    assert level(run.see(0.8, 0.8, 0.8)) == 0.0
    assert level(run.see(*[None] * 8)) == 1.0


def test_a_camera_that_is_dead_means_that_the_target_is_gone():
    run = rehearse_alarm(
        replace(NEAR_WITH_GRACE, name="gone", condition=PresenceCondition(seen=False), on_delay=OnDelay(hold_s=1.0))
    )
    run.see(2, 2, 2)
    run.wait(0.8)
    assert run.events("gone") == []
    run.wait(1.0)
    assert run.events("gone") == ["raised"]


def test_a_camera_that_is_dead_ends_being_seen():
    run = rehearse_alarm(replace(NEAR_WITH_GRACE, name="there", condition=PresenceCondition(seen=True)))
    run.see(2, 2, 2)
    assert run.events("there") == ["raised"]
    run.wait(2.0)
    assert run.events("there") == ["raised", "cleared"]


def test_a_target_that_creeps_over_the_limit_is_noticed_when_that_is_likely_enough():
    run = Rehearsal(Plan(targets=("ball",), rules=(replace(NEAR_WITH_GRACE, output=None),)))
    run.see(*[1.1] * 10, *[0.997] * 10, sigma_m=0.03)
    assert run.events("near") == []
    run.see(0.98, 0.97, 0.96, 0.95, 0.94, 0.93, sigma_m=0.03)
    assert run.events("near") == ["raised"]


def test_a_target_between_two_limits_that_is_no_longer_sure_to_be_there_is_noticed():
    between = DistanceCondition(above=0.98, below=1.02, deadband_sigmas=0.0)
    run = Rehearsal(Plan(targets=("ball",), rules=(replace(NEAR_WITH_GRACE, output=None, condition=between),)))
    run.see(*[1.0] * 10, sigma_m=0.001)
    run.see(*[1.0] * 30, sigma_m=0.5)
    assert run.events("near") == ["raised", "cleared"]


# The table of an alarm's phases, over every phase and every trigger.

CLEARING = {AlarmState.CLEARING, AlarmState.CLEARING_UNACKNOWLEDGED}
AT_REST = {AlarmState.NORMAL, AlarmState.PENDING, AlarmState.RTN_UNACKNOWLEDGED}


def after(phase: AlarmState, trigger: Trigger) -> AlarmState:
    state = AlarmRecord(state=phase)
    fire(state, trigger)
    return state.state


def broken_rules(phase: AlarmState, trigger: Trigger) -> list[str]:
    """Return the rules that one cell of the table breaks."""
    to = after(phase, trigger)
    raises = trigger in {Trigger.RAISE, Trigger.RAISE_ACKNOWLEDGED}
    is_reset = phase is AlarmState.LATCHED and trigger is Trigger.RESET
    becomes_active, ends = phase not in ACTIVE and to in ACTIVE, phase in ACTIVE and to not in ACTIVE
    is_cleared = phase in ACTIVE - LATCHED and trigger is Trigger.CLEAR
    need_ends, need_begins = phase in TO_ACKNOWLEDGE - {to} and to not in TO_ACKNOWLEDGE, to in TO_ACKNOWLEDGE
    need_begins = need_begins and phase not in TO_ACKNOWLEDGE
    raised_without = phase is AlarmState.RTN_UNACKNOWLEDGED and trigger is Trigger.RAISE_ACKNOWLEDGED
    is_raised, is_realarmed = trigger is Trigger.RAISE, trigger is Trigger.REALARM
    unlatches = phase in LATCHED and to not in LATCHED
    acknowledged = trigger is Trigger.ACKNOWLEDGE and phase in ACTIVE
    rules = {
        "only being raised makes an alarm active": becomes_active is (phase in AT_REST and raises),
        "only clearing or a reset ends an active alarm": ends is (is_cleared or is_reset),
        "only an acknowledgement takes the need for one away": need_ends
        is (phase in TO_ACKNOWLEDGE and (trigger is Trigger.ACKNOWLEDGE or raised_without)),
        "only a raise or a re-alarm asks for an acknowledgement": need_begins
        is ((phase in AT_REST - TO_ACKNOWLEDGE and is_raised) or (phase in ACTIVE - TO_ACKNOWLEDGE and is_realarmed)),
        "a latched alarm waits for a reset or holds again": unlatches
        is (phase in LATCHED and (trigger is Trigger.HOLDS or is_reset)),
        "an acknowledgement changes nothing else": not acknowledged
        or (to in ACTIVE and (to in CLEARING) is (phase in CLEARING) and (to in LATCHED) is (phase in LATCHED)),
        "the same trigger twice is like once": after(to, trigger) is to,
    }
    return [rule for rule, is_kept in rules.items() if not is_kept]


def test_every_cell_of_the_table():
    broken = {f"{phase} × {trigger}": broken_rules(phase, trigger) for phase in AlarmState for trigger in Trigger}
    assert {cell: rules for cell, rules in broken.items() if rules} == {}


def test_every_phase_can_be_reached_and_every_phase_can_come_to_rest():
    reached, edge = {AlarmState.NORMAL}, {AlarmState.NORMAL}
    while edge:
        edge = {after(phase, trigger) for phase in edge for trigger in Trigger} - reached
        reached |= edge
    assert reached == set(AlarmState)
    to_rest = {AlarmState.NORMAL}
    while more := {phase for phase in AlarmState if {after(phase, t) for t in Trigger} & to_rest} - to_rest:
        to_rest |= more
    assert to_rest == set(AlarmState)


# Alarms that latch, that somebody must acknowledge, that are reported again, and the first of a group.


def status(decision, rule="near"):
    return next(trace for trace in decision.rules if trace.rule == rule)


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


def test_a_latch_until_acknowledged_goes_on_after_its_condition_and_ends_when_it_is_acknowledged():
    run = rehearse(latch=True, ack_resets=True, ack="required")
    run.see(*FAR, *CLOSE, *FAR, *FAR)
    assert (status(run.see(3)).status, level(run.see(3))) == (RuleStatus.LATCHED, 1.0)
    assert run.tell("acknowledge", "near", by="Ben").accepted
    decision = run.see(3)
    assert (status(decision).status, level(decision)) == (RuleStatus.IDLE, 0.0)
    assert run.events("near") == ["raised", "acknowledged", "cleared"]


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
