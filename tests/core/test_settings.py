"""What an operator sets of a rule while it runs: thresholds, and that it is observed only."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.app.persistence.resumption import read_state, state_text
from stadimeter.core.alarms.machine import show_thresholds, thresholds_of
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.of_rules import BatteryCondition, RuleCondition
from stadimeter.core.conditions.sight import CountCondition, PresenceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Severity
from stadimeter.core.persistence import SnapshotChange, classify_change, reload, restore_alarms, snapshot_alarms
from stadimeter.core.rules.explaining import explain
from support.conditions import closing, direction
from support.each_case import each_case
from support.random_runs import random_run, with_settings
from support.two_rules import FAR, NEAR, plan_of, rehearse

BAND = replace(NEAR, name="band", condition=DistanceCondition(above=1.0, below=2.0))
AWAY = replace(NEAR, name="away", condition=DistanceCondition(above=1.0, deadband=0.25))


def record_of(run, index=0):
    return run.state.rules.steps[index].record


def judged(run, index=0):
    return run.state.rules.rules[index]


def reasons(run, kind):
    return [event.reason for _, decision in run.decisions for event in decision.events if event.kind == kind]


def run_at(distance_m, *rules):
    run = rehearse(*(rules or (NEAR,)))
    run.see(*[distance_m] * 5)
    return run


# A threshold


def test_a_rule_that_rests_is_judged_by_its_new_threshold_in_the_cycle_that_sets_it_and_raised_by_the_next_frame():
    run = run_at(1.5)
    answer = run.tell("set-threshold", "near", by="zoe", why="the dog", value=2.0)
    assert (answer.accepted, answer.words) == (True, "set-threshold: near")
    assert run.see(1.5).commands[0].level == 1.0
    assert run.events("near") == ["threshold_set", "raised"]
    (reason,) = reasons(run, "threshold_set")
    assert reason == "below is 2.00 m (6.6 ft), the configuration says 1.00 m (3.3 ft): by zoe: the dog"


def test_a_raised_alarm_clears_by_its_new_threshold_and_after_its_off_delay():
    run = run_at(0.9)
    run.tell("set-threshold", "near", value=0.5)
    run.see(*[0.9] * 15)
    assert run.events("near") == ["raised", "threshold_set"]
    run.see(*[0.9] * 10)
    assert run.events("near") == ["raised", "threshold_set", "cleared"]


def test_a_threshold_that_is_withdrawn_is_again_that_of_the_configuration():
    run = run_at(1.5)
    run.tell("set-threshold", "near", value=0.3)
    assert run.tell("withdraw-threshold", "near", by="zoe").accepted
    assert judged(run) == NEAR
    assert record_of(run).thresholds == ()
    assert reasons(run, "threshold_withdrawn") == ["below is 1.00 m (3.3 ft) again, as the configuration says: by zoe"]
    assert not run.tell("withdraw-threshold", "near").accepted


def test_every_threshold_that_was_set_is_withdrawn_at_once_without_a_rule_or_a_key():
    run = run_at(3.0, NEAR, BAND, FAR)
    run.tell("set-threshold", "near", value=0.3)
    run.tell("set-threshold", "band", key="between.far", value=5.0)
    run.tell("set-threshold", "band", key="between.near", value=4.0)
    answer = run.tell("withdraw-threshold")
    assert (answer.accepted, answer.words) == (True, "withdraw-threshold: near, band")
    assert run.state.rules.rules == run.state.plan.rules


@each_case(
    ("rule", "how", "words"),
    [
        (NEAR, {}, "name the value"),
        (NEAR, {"value": math.nan}, "below takes 1e-12 to 1e+09 m, and not nan"),
        (NEAR, {"value": 0.0}, "below takes 1e-12 to 1e+09 m, and not 0"),
        (NEAR, {"value": 2e9}, "below takes 1e-12 to 1e+09 m, and not 2e+09"),
        (NEAR, {"value": 0.6, "unit": "s"}, "below is in m, and not in s"),
        (NEAR, {"value": 0.6, "key": "above"}, "it has no threshold 'above'; there are: below"),
        (BAND, {"value": 0.6}, "name one of its thresholds; there are: between.near, between.far"),
        (BAND, {"value": 2.0, "key": "between.near"}, "between.near takes 1e-12 to 2 m, and not 2"),
        (BAND, {"value": 0.9, "key": "between.far"}, "between.far takes 1 to 1e+09 m, and not 0.9"),
        (AWAY, {"value": 0.25}, "above takes 0.25 to 1e+09 m, and not 0.25"),
        (replace(NEAR, condition=CountCondition(at_least=2)), {"value": 1.0}, "it has no threshold that can be set"),
        (
            replace(NEAR, severity=Severity.SAFETY),
            {"value": 2.0},
            "the thresholds of a safety rule are those of its configuration",
        ),
    ],
)
def test_what_the_configuration_would_not_take_is_refused_in_a_sentence_and_changes_nothing(rule, how, words):
    run = run_at(3.0, rule)
    before = record_of(run)
    answer = run.tell("set-threshold", rule.name, **how)
    assert (answer.accepted, answer.words) == (False, f"{rule.name}: {words}")
    assert record_of(run) == before
    assert judged(run) == rule
    assert run.events(rule.name)[-1] == "refused"


def test_one_end_of_an_interval_is_not_withdrawn_beyond_the_other_that_is_set():
    run = run_at(3.0, BAND)
    run.tell("set-threshold", "band", key="between.far", value=5.0)
    run.tell("set-threshold", "band", key="between.near", value=3.0)
    answer = run.tell("withdraw-threshold", "band", key="between.far")
    assert answer.words == ("band: between.far takes 3 to 1e+09 m while the others are set; withdraw all at once")
    assert run.tell("withdraw-threshold", "band", key="between.near").accepted
    assert [each.key for each in record_of(run).thresholds] == ["between.far"]
    assert run.tell("withdraw-threshold", "band").accepted


def named(condition):
    return {key: found.value for key, found in thresholds_of(replace(NEAR, condition=condition)).items()}


@each_case(
    ("condition", "names"),
    [
        (DistanceCondition(below=1.0), {"below": 1.0}),
        (DistanceCondition(above=1.0, quantity="depth"), {"above": 1.0}),
        (DistanceCondition(above=1.0, below=2.0), {"between.near": 1.0, "between.far": 2.0}),
        (direction(above=0.1, below=0.2), {"bearing.between.low": 0.1, "bearing.between.high": 0.2}),
        (closing(above=0.5), {"closing_speed.above": 0.5}),
        (TimeToContactCondition(below_s=2.0), {"time_to_contact.below": 2.0}),
        (BatteryCondition(below=11.0), {"base.battery_below": 11.0}),
        (PresenceCondition(seen=False, for_s=3.0), {"lost": 3.0}),
        (PresenceCondition(seen=False), {}),
        (RuleCondition(rule="far"), {}),
        (
            AllOf(conditions=(DistanceCondition(below=1.0), closing(above=0.5))),
            {"below": 1.0, "closing_speed.above": 0.5},
        ),
        (
            AnyOf(
                conditions=(
                    DistanceCondition(below=1.0),
                    Not(condition=DistanceCondition(below=3.0)),
                    BatteryCondition(below=11.0),
                )
            ),
            {"any.0.below": 1.0, "any.1.not.below": 3.0, "base.battery_below": 11.0},
        ),
    ],
)
def test_thresholds_are_called_as_in_the_configuration(condition, names):
    assert named(condition) == names


# What others see


def test_an_explanation_says_who_has_set_a_threshold_and_what_the_configuration_says():
    run = run_at(3.0)
    run.tell("set-threshold", "near", by="zoe", value=0.6)
    run.wait(12)
    found = explain(run.see(3.0), "near")
    words = "`below` is 0.60 m (2.0 ft), set by zoe 12.1 s ago, where the configuration says 1.00 m (3.3 ft)"
    assert found.sentence.endswith(words)
    assert found.sentence.endswith(words)


def test_what_others_see_has_the_value_that_of_the_configuration_and_what_is_taken():
    run = run_at(3.0, BAND)
    run.tell("set-threshold", "band", key="between.far", value=5.0, by="")
    far = show_thresholds(judged(run), record_of(run))["between.far"]
    assert (far.value, far.configured, far.unit, far.set_by) == (5.0, 2.0, "m", "an operator")
    near = show_thresholds(judged(run), record_of(run))["between.near"]
    assert (near.value, near.configured, near.set_by) == (1.0, 1.0, None)
    assert near.max == math.nextafter(5.0, 0)


# Beyond a restart and a reload


def restarted(run, *rules):
    memories = snapshot_alarms(run.state)
    state = initial_state(plan_of(*rules))
    return restore_alarms(state, memories, shift_s=100.0 - run.now_s, from_s=100.0, now_s=100.0)


def test_what_is_set_is_lasting_and_goes_on_after_a_restart():
    run = run_at(3.0)
    before = run.state
    run.tell("set-threshold", "near", by="zoe", value=0.6)
    assert classify_change(before, run.state) is SnapshotChange.LASTING
    run.tell("observe", "near")
    after = restarted(run, NEAR)
    assert after.rules.rules == run.state.rules.rules
    assert after.rules.rules[0].condition.below == 0.6
    assert after.rules.traces[0].inhibits == ("observed",)
    (found,) = after.rules.steps[0].record.thresholds
    assert found.at_s == pytest.approx(100.0 - 0.001)


CHANGED = replace(NEAR, off_delay_s=5.0)
OTHERWISE = replace(NEAR, condition=DistanceCondition(below=0.7))
WIDE = replace(AWAY, condition=DistanceCondition(above=1.0, deadband=0.5))


def after_restart(run, rule):
    state = restarted(run, rule)
    return state, state.due


def after_reload(run, rule):
    state = reload(run.state, plan_of(rule)).state
    return state, state.due


@each_case("after", [after_restart, after_reload])
@each_case(
    ("rule", "value", "now", "is_kept"),
    [
        (NEAR, 0.6, CHANGED, True),
        (NEAR, 0.6, OTHERWISE, False),
        (NEAR, 0.6, replace(NEAR, severity=Severity.SAFETY), False),
        (NEAR, 0.6, replace(NEAR, condition=PresenceCondition(seen=True)), False),
        (AWAY, 0.4, WIDE, False),
        (AWAY, 0.6, WIDE, True),
    ],
)
def test_a_set_threshold_stays_while_the_configuration_says_the_same_in_place_of_it_and_takes_it(
    after, rule, value, now, is_kept
):
    run = run_at(3.0, rule)
    run.tell("set-threshold", rule.name, by="zoe", value=value)
    state, due = after(run, now)
    assert (len(state.rules.steps[0].record.thresholds) == 1) is is_kept
    assert (state.rules.rules[0] == now) is not is_kept
    withdrawn = [event for event in due if event.kind == "threshold_withdrawn"]
    assert [event.source for event in withdrawn] == ([] if is_kept else [rule.name])
    for event in withdrawn:
        assert event.reason.startswith(f"{'above' if rule is AWAY else 'below'} was {value:.2f} m")
        assert event.reason.endswith("set by zoe; the configuration was changed, and counts")


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_a_run_goes_on_from_any_moment_as_it_would_have_to_the_last_bit(seed):
    run = with_settings(random_run(seed), seed)
    state = initial_state(run.plan)
    for observation in run.observations[:40]:
        state, _ = decide(state, observation)
    again = read_state(state_text(state), initial_state(run.plan))
    for observation in run.observations[40:]:
        state, decision = decide(state, observation)
        again, same = decide(again, observation)
        assert same == decision
        assert dict(same.reasons) == dict(decision.reasons)


# Observed only


def test_an_observed_rule_lets_go_at_once_and_drives_and_sends_nothing_until_it_acts_again():
    run = run_at(0.5)
    assert run.decisions[-1][1].commands[0].level == 1.0
    answer = run.tell("observe", "near", by="zoe", why="trying")
    assert answer.accepted
    assert run.decisions[-1][1].commands[0].level == 0.0
    assert "kept quiet: it is only observed, as an operator wants" in explain(run.see(0.5), "near").sentence
    assert run.decisions[-1][1].rules[0].inhibits == ("observed",)
    run.see(*[3.0] * 25)
    run.see(*[0.5] * 5)
    assert not any(event.notify for event in run.decisions[-1][1].events)
    assert run.tell("act", "near").accepted
    assert run.see(0.5).commands[0].level == 1.0
    assert run.events("near") == ["raised", "observed", "cleared", "raised", "acting", "realarmed"]
    assert judged(run) == NEAR


@each_case(
    ("action", "rule", "words"),
    [
        ("observe", replace(NEAR, severity=Severity.SAFETY), "a safety rule cannot be kept quiet"),
        ("observe", replace(NEAR, observe=True), "it is only observed already"),
        ("act", replace(NEAR, observe=True), "its configuration says observe = true"),
        ("act", NEAR, "it is not only observed"),
    ],
)
def test_observing_is_refused_where_it_means_nothing_or_is_not_safe(action, rule, words):
    run = run_at(3.0, rule)
    assert run.tell(action, "near").words == f"near: {words}"
    assert judged(run) == rule


def test_an_observed_rule_that_is_removed_clears_without_notifying_anybody():
    run = run_at(0.5, NEAR, FAR)
    run.tell("observe", "near")
    (event,) = reload(run.state, plan_of(FAR)).state.due
    assert (event.kind, event.notify) == ("cleared", False)
