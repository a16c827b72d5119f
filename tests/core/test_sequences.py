"""What alarms do step after step: patterns, other outputs, messages; what suppresses them; and in which order."""

import math
from graphlib import CycleError

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.command import TwistCommand
from stadimeter.core.conditions.compounds import AllOf, Not
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decide import initial_state
from stadimeter.core.decision import RuleStatus
from stadimeter.core.plan import BaseOutput, LevelOutput, Plan
from stadimeter.core.rule import AlarmRule, EscalationStep, FollowRule, Pattern, Send, Template
from support.each_case import each_case
from support.near_alarm import CLOSE, FAR, NEAR, rehearse

CALL = EscalationStep(after_s=1.0, send=Send(template=Template(text="{rule}"), notifier="phone"))


def levels(decision):
    return [command.level for command in decision.commands if not isinstance(command, TwistCommand)]


def sent(run):
    return [(notice.rule, notice.step) for _, decision in run.decisions for notice in decision.notices]


def begun_at_s(run, output=0):
    return next(at_s for at_s, decision in run.decisions if levels(decision)[output] > 0)


def test_a_pattern_changes_the_level_while_the_alarm_stands():
    run = rehearse(replace(NEAR, pattern=Pattern(steps=((1.0, 0.2), (0.25, 0.2)))))
    run.see(*FAR, 0.5)
    seen = [levels(run.see(0.5))[0] for _ in range(8)]
    assert sorted(set(seen)) == [0.25, 1.0]
    assert seen[:4] == seen[4:]
    assert levels(run.see(*FAR))[0] == 0.0


def test_a_later_step_drives_another_output_and_then_lets_go():
    run = rehearse(replace(NEAR, escalation=(EscalationStep(after_s=0.5, output="lamp", level=0.5, for_s=0.4),)))
    run.see(*FAR)
    seen = [levels(run.see(0.5)) for _ in range(15)]
    began_s = begun_at_s(run)
    lamp = [round(at_s - began_s, 1) for at_s, decision in run.decisions if levels(decision)[1] == 0.5]
    assert lamp == [0.5, 0.6, 0.7, 0.8]
    assert seen[-1] == [1.0, 0.0]


def test_a_later_step_on_the_same_output_replaces_what_the_alarm_asks_for():
    run = rehearse(replace(NEAR, level=0.2, escalation=(EscalationStep(after_s=0.5, output="buzzer", level=0.9),)))
    run.see(*FAR)
    assert levels(run.see(0.5, 0.5))[0] == 0.2
    assert levels(run.see(*[0.5] * 8))[0] == 0.9


def test_a_message_is_sent_once_when_it_is_due():
    run = rehearse(replace(NEAR, escalation=(CALL,)))
    run.see(*FAR, *[0.5] * 9)
    assert sent(run) == []
    run.see(*[0.5] * 20)
    assert sent(run) == [("near", 0)]


def test_a_message_that_comes_late_tells_the_figures_of_its_moment_and_none_out_of_sight():
    seen, gone = rehearse(replace(NEAR, escalation=(CALL,))), rehearse(replace(NEAR, escalation=(CALL,)))
    seen.see(*FAR, 0.5, 0.5, *[0.7] * 12)
    gone.see(*FAR, 0.5, 0.5, *[None] * 12)
    (now,), (unknown,) = (
        [notice.event for _, each in run.decisions for notice in each.notices] for run in (seen, gone)
    )
    assert now.distance_m == pytest.approx(0.7, abs=0.02)
    assert (unknown.distance_m, unknown.sigma_m) == (None, None)


def test_what_is_not_due_when_the_alarm_clears_is_not_sent():
    run = rehearse(replace(NEAR, escalation=(CALL,)))
    run.see(*FAR, *CLOSE, *FAR, *[3.0] * 20)
    assert run.events("near") == ["raised", "cleared"]
    assert sent(run) == []


def test_what_was_acknowledged_is_not_escalated():
    run = rehearse(replace(NEAR, ack="required", escalation=(replace(CALL, only_unacknowledged=True),)))
    run.see(*FAR, *CLOSE)
    run.tell("acknowledge", "near")
    run.see(*[0.5] * 20)
    assert sent(run) == []


def test_a_step_after_clearing_is_done_then():
    bell = EscalationStep(on="cleared", output="lamp", for_s=0.3)
    run = rehearse(replace(NEAR, escalation=(bell, replace(CALL, on="cleared", after_s=0.0))))
    run.see(*FAR, *CLOSE)
    assert sent(run) == []
    run.see(*FAR, *FAR)
    assert sent(run) == [("near", 1)]
    assert sum(levels(decision)[1] == 1.0 for _, decision in run.decisions) == 3


def test_a_pattern_after_clearing_goes_on_though_the_alarm_itself_rests():
    beeps = EscalationStep(on="cleared", output="lamp", pattern=Pattern(steps=((1.0, 0.2), (0.0, 0.2))), for_s=1.0)
    run = rehearse(replace(NEAR, escalation=(beeps,)))
    run.see(*CLOSE)
    seen = [levels(run.see(3.0))[1] for _ in range(20)]
    assert sum(now > before for before, now in zip([0.0, *seen], seen, strict=False)) == 3
    assert seen[-5:] == [0.0] * 5


def test_a_message_counts_how_often_the_alarm_was_raised():
    run = rehearse(replace(NEAR, escalation=(replace(CALL, after_s=0.0),)))
    for _ in range(3):
        run.see(*FAR, *CLOSE)
    assert [notice.count for _, decision in run.decisions for notice in decision.notices] == [1, 2, 3]


def test_a_suppressed_alarm_is_quiet_and_tells_what_suppresses_it():
    maintenance = AlarmRule(name="far", target="ball", condition=DistanceCondition(below=0.7), off_delay_s=0.2)
    run = rehearse(replace(NEAR, suppress_when=RuleCondition(rule="far"), escalation=(CALL,)), maintenance)
    run.see(*FAR)
    assert levels(run.see(0.9, 0.9))[0] == 1.0
    decision = run.see(*CLOSE)
    assert levels(decision)[0] == 0.0
    assert decision.rules[0].inhibits == ("suppressed",)
    run.see(*[0.5] * 20)
    assert sent(run) == []
    assert levels(run.see(*[0.9] * 6))[0] == 1.0
    assert run.events("near") == ["raised", "suppressed", "unsuppressed"]


def test_what_cannot_be_known_suppresses_nothing():
    far = AlarmRule(name="far", target="ball", condition=DistanceCondition(below=0.7))
    gone = AlarmRule(
        name="gone",
        target="ball",
        output="buzzer",
        condition=PresenceCondition(seen=False),
        suppress_when=RuleCondition(rule="far"),
    )
    run = rehearse(gone, far)
    run.see(3, 3)
    assert levels(run.see(*[None] * 10))[0] == 1.0


def test_a_rule_that_asks_for_another_is_judged_after_it_wherever_it_stands():
    second = AlarmRule(
        name="both", target="ball", output="lamp", condition=AllOf(conditions=(RuleCondition(rule="near"),))
    )
    run = rehearse(second, NEAR)
    run.see(*FAR, *CLOSE)
    raised = [(at_s, e.source) for at_s, d in run.decisions for e in d.events if e.kind.value == "raised"]
    assert [source for _, source in raised] == ["near", "both"]
    assert raised[0][0] == raised[1][0]


def test_a_rule_on_the_contrary_of_another_follows_it():
    second = AlarmRule(
        name="free", target="ball", output="lamp", condition=Not(condition=RuleCondition(rule="near")), off_delay_s=0.0
    )
    run = rehearse(second, NEAR)
    assert levels(run.see(*FAR)) == [0.0, 1.0]
    assert levels(run.see(*CLOSE)) == [1.0, 0.0]
    run.see(*[None] * 10)
    assert run.decisions[-1][1].rules[0].status is RuleStatus.IDLE
    run.see(*FAR, *FAR, *[None] * 10)
    assert run.decisions[-1][1].rules[0].status is RuleStatus.ACTIVE
    assert levels(run.see(*[None] * 60)) == [0.0, 0.0]
    assert run.decisions[-1][1].rules[0].status is RuleStatus.UNKNOWN


def test_rules_that_ask_for_each_other_in_a_circle_are_refused():
    first = replace(NEAR, name="a", suppress_when=RuleCondition(rule="b"))
    second = replace(NEAR, name="b", suppress_when=RuleCondition(rule="a"))
    with pytest.raises(CycleError):
        initial_state(Plan(targets=("ball",), rules=(first, second)))
    with pytest.raises(KeyError, match="b"):
        initial_state(Plan(targets=("ball",), rules=(first,)))


@pytest.mark.parametrize(("combine", "level", "winner"), [("max", 0.8, "b"), ("min", 0.3, "a")])
def test_of_equals_an_output_that_combines_takes_the_highest_or_the_lowest(combine, level, winner):
    rules = (replace(NEAR, name="a", level=0.3), replace(NEAR, name="b", level=0.8))
    run = rehearse(*rules, outputs=(LevelOutput(name="buzzer", combine=combine),))
    decision = run.see(*FAR, *CLOSE)
    assert levels(decision)[0] == level
    assert decision.outputs[0].winner == winner
    assert set(decision.outputs[0].losers) == {"a", "b"} - {winner}


def test_a_base_stops_where_one_rule_of_equals_stops_it():
    follow = FollowRule(name="follow", target="ball", output="base", distance_m=0.1)
    run = rehearse(follow, replace(NEAR, output="base"), outputs=(BaseOutput(name="base", combine="most_restrictive"),))
    assert run.see(*FAR).commands[0].linear_mps > 0
    assert run.see(*CLOSE).commands[0].linear_mps == 0


# Levels that change by themselves.

THREE_BURSTS = Pattern(steps=((1.0, 0.2), (0.0, 0.3)), times=3)

steps = st.lists(st.tuples(st.floats(0, 1), st.floats(0.05, 60)), min_size=1, max_size=8).map(tuple)
times_s = st.floats(0, 1e5)


@each_case(
    ("since_s", "level"),
    [(0.0, 1.0), (0.199, 1.0), (0.2, 0.0), (0.499, 0.0), (0.5, 1.0), (1.199, 1.0), (1.2, 0.0), (1.5, 0.0), (99.0, 0.0)],
)
def test_a_pattern_is_gone_through_as_often_as_it_says_and_then_is_off(since_s, level):
    assert THREE_BURSTS.level(since_s) == level


def test_sums_of_frame_times_do_not_shift_a_step():
    since_s = 0.0
    levels = []
    for _ in range(15):
        levels.append(THREE_BURSTS.level(since_s))
        since_s += 0.1
    assert levels == [1, 1, 0, 0, 0] * 3


@given(steps, times_s, st.integers(0, 5))
def test_a_level_is_always_one_of_the_steps_or_off(levels, since_s, times):
    found = Pattern(steps=levels, times=times).level(since_s)
    assert found in {0.0, *(level for level, _ in levels)}


@given(steps, st.integers(1, 5))
def test_after_its_last_turn_a_pattern_is_off(levels, times):
    whole_s = math.fsum(for_s for _, for_s in levels) * times
    assert Pattern(steps=levels, times=times).level(whole_s + 0.001) == 0.0
