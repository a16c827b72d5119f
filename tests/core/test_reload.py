"""A changed configuration is taken over by the rules that mean the same; and what of it all is worth writing down."""

import pytest
from msgspec.structs import replace

from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.decision import EventKind
from stadimeter.core.persistence import SnapshotChange, classify_change, reload
from stadimeter.core.rule import OnDelay
from support.two_rules import FAR, NEAR, plan_of, rehearse

# What is worth writing down


def turns(run, *distances_m, **how):
    found = []
    for distance_m in distances_m:
        before = run.state
        run.see(distance_m, **how)
        found.append(classify_change(before, run.state))
    return found


def test_a_quiet_scene_is_nothing_to_write_down():
    run = rehearse(NEAR, FAR)
    run.see(3, 3, 3)
    assert set(turns(run, *[3.0, 3.01, 2.99] * 20)) == {SnapshotChange.NOTHING}


def test_a_timer_that_runs_is_nothing_and_one_that_begins_is_passing():
    run = rehearse(replace(NEAR, on_delay=OnDelay(hold_s=5.0)))
    run.see(3, 3, 3)
    found = turns(run, *[0.6] * 10)
    assert found.count(SnapshotChange.PASSING) == 1
    assert SnapshotChange.LASTING not in found


@pytest.mark.parametrize(("for_s", "expected"), [(20.0, SnapshotChange.PASSING), (0.0, SnapshotChange.NOTHING)])
def test_that_a_target_goes_is_worth_it_if_a_rule_counts_the_time(for_s, expected):
    rule = replace(NEAR, condition=PresenceCondition(seen=False, for_s=for_s), on_delay=OnDelay(hold_s=1e6))
    run = rehearse(rule)
    run.see(3, 3, 3)
    before = run.state
    while run.state.tracks[0].track.is_valid:
        before = run.state
        run.see(None)
    assert classify_change(replace(before, rules=run.state.rules), run.state) is expected


def test_what_people_are_told_of_is_lasting():
    run = rehearse(NEAR)
    run.see(3, 3, 3)
    assert max(turns(run, 0.6, 0.6)) is SnapshotChange.LASTING


def test_what_people_say_is_lasting():
    run = rehearse(NEAR)
    run.see(3, 3, 3)
    before = run.state
    run.tell("shelve", "near", for_s=60)
    assert classify_change(before, run.state) is SnapshotChange.LASTING


# A changed configuration


def test_rules_that_mean_the_same_go_on_as_if_nothing_had_happened():
    run = rehearse(NEAR, FAR)
    run.see(3, 0.6, 0.6, 0.6)
    steps = run.state.rules.steps
    taken = reload(run.state, plan_of(replace(NEAR, name="other", output=None), NEAR, FAR))
    assert taken.state.rules.steps[1:] == steps
    assert (taken.kept, taken.added, taken.changed, taken.removed) == (("near", "far"), ("other",), (), ())
    run.state = taken.state
    assert run.see(0.6).commands[0].level == 1.0
    assert run.events("near") == ["raised"]


def test_an_alarm_whose_rule_is_removed_clears_and_lets_its_output_go_at_once():
    run = rehearse(NEAR, FAR)
    run.see(3, 0.6, 0.6, 0.6)
    run.state = reload(run.state, plan_of(FAR)).state
    decision = run.see(0.6)
    (event,) = [event for event in decision.events if event.source == "near"]
    assert (event.kind, event.reason) == (EventKind.CLEARED, "removed from the configuration")
    assert event.sequence == len(run.events()) - 1
    assert decision.commands[0].level == 0.0
    assert [trace.rule for trace in decision.rules] == ["far"]
    run.see(0.6, 0.6)
    assert run.events("near") == ["raised", "cleared"]


def test_an_alarm_whose_rule_is_changed_clears_and_begins_anew():
    run = rehearse(NEAR)
    run.see(3, 0.6, 0.6, 0.6)
    taken = reload(run.state, plan_of(replace(NEAR, condition=DistanceCondition(below=0.7))))
    assert taken.changed == ("near",)
    run.state = taken.state
    run.see(0.6, 0.6)
    assert run.events("near") == ["raised", "cleared", "raised"]


def test_a_rule_that_did_nothing_is_removed_without_a_word():
    run = rehearse(NEAR, FAR)
    run.see(3, 3, 3)
    run.state = reload(run.state, plan_of(FAR)).state
    run.see(3)
    assert run.events("near") == []


def test_targets_outputs_and_safety_go_on():
    run = rehearse(NEAR, FAR)
    run.see(3, 3, 3, 3)
    before = run.state
    after = reload(before, plan_of(FAR)).state
    assert (after.tracks, after.outputs, after.safety, after.now_s) == (
        before.tracks,
        before.outputs,
        before.safety,
        before.now_s,
    )
    run.state = after
    assert run.see(3).commands[1].level == pytest.approx(0.5, abs=0.01)


def test_taking_over_the_same_configuration_changes_no_decision():
    with_reload, without = rehearse(NEAR, FAR), rehearse(NEAR, FAR)
    for count, distance_m in enumerate([3, 2, 0.6, 0.6, 0.6, 3, 3, 3, None, None, 0.6, 0.6] * 3):
        with_reload.state = reload(with_reload.state, plan_of(NEAR, FAR)).state
        assert with_reload.see(distance_m) == without.see(distance_m), count
